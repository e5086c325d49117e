"""What the commands share: consoles, progress bars, and files that must not be lost."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich import progress as rich_progress
from rich.console import Console

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress

if TYPE_CHECKING:
    from kinefilter.pipeline.training import PairedTake

__all__ = [
    "Skeletons",
    "ended_gently",
    "err",
    "keep",
    "out",
    "progress_bars",
    "read_all",
    "write_json",
]

out = Console(soft_wrap=True, highlight=False)
err = Console(stderr=True, soft_wrap=True, highlight=False)

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


@contextmanager
def ended_gently() -> Iterator[None]:
    """Take a request to end, as batch systems send it, for Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield  # others may not say what a signal does
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def read_all(files: Sequence[Path]) -> list[PairedTake]:
    """Return the clips of pairs files."""
    from kinefilter.pipeline.training import read_pairs

    return [pair for file in files for pair in read_pairs(file)]


def write_json(figures: object, path: Path) -> None:
    """Write figures as JSON, whole or not at all."""
    from kinefilter.pipeline.formats import atomic_path

    with atomic_path(path) as temporary:
        text = json.dumps(figures, indent=2, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
