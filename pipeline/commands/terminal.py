"""What the commands share: consoles, progress bars, and files that must not be lost."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich import progress as rich_progress
from rich.console import Console

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress, over

if TYPE_CHECKING:
    from kinefilter.pipeline.pairs import PairedTake

# Names of files are printed as they are, whatever brackets and colons they hold.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)

Skeletons = Literal["kinect_v1", "kinect_v2"]


def keep(written: Path, *others: Path | None) -> None:
    """Raise an InputError if a file to write is one that must not be lost."""
    for other in others:
        if other is not None and written.resolve() == other.resolve():
            raise InputError(
                f"{written}: would overwrite {other}; give another name to write to"
            )


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Yield what shows on the terminal how far long work is."""
    columns = (
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.MofNCompleteColumn(),
        rich_progress.TimeRemainingColumn(),
    )
    with rich_progress.Progress(
        *columns, console=err, transient=True, disable=not err.is_terminal
    ) as bars:
        yield lambda stage, count: bars.track(range(count), count, description=stage)


def clips_of(files: Sequence[Path], progress: Progress) -> Iterator[PairedTake]:
    """Yield the clips of pairs files, a file at a time in memory."""
    from kinefilter.pipeline.pairs import read_pairs

    for file in over(files, "read", progress):
        yield from read_pairs(file)


def in_folders(paths: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    """Return files as they are, and for a folder those below it that end as one says.

    Raises:
        InputError: A folder holds none.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(
            file
            for file in path.rglob("*")
            if file.name.lower().endswith(tuple(suffixes)) and file.is_file()
        )
        if not inside:
            raise InputError(f"{path}: no {', '.join(suffixes)} in this folder")
        found += inside
    return found


def write_json(figures: object, path: Path) -> None:
    """Write figures as JSON, whole or not at all."""
    from kinefilter.pipeline.formats import atomic_path

    with atomic_path(path) as temporary:
        text = json.dumps(figures, indent=2, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
