"""The studies by name, and which of them a folder already holds."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

from .chiang import (
    chiang_figure_5,
    chiang_figure_7,
    chiang_table_1,
    chiang_tables_2_3,
)
from .cleaned_takes import cleaned_takes
from .depth_tracker import tracker_errors, tracker_lessons
from .detection import failures, reliability
from .liu import (
    liu_figure_3,
    liu_figure_7,
    liu_figure_8,
    liu_table_2,
    liu_table_3,
    liu_table_4,
    liu_table_5,
)
from .methods import methods_known_people, methods_new_people, presets
from .shum import shum_figure_8, shum_table_3, shum_table_4, shum_tables_1_2
from .speed import million_postures, speed
from .study import Options, Study
from .wang import wang_figure_1, wang_table_1

_FLOORS = ("characters", "retarget", "scenes", "pipeline")
_SUFFIXES = (".py", ".toml", ".xml", ".npz", ".csv")
_EXCEPT = ("claims.toml",)  # which judges, and measures nothing


class _Entry(NamedTuple):
    """A study and the sizes that make it quick."""

    run: Callable[..., Study]
    quick: dict[str, int]


STUDIES: dict[str, _Entry] = {
    "cleaned-takes": _Entry(cleaned_takes, {"count": 2}),
    "methods-new-people": _Entry(methods_new_people, {"count": 2, "movements": 1}),
    "methods-known-people": _Entry(methods_known_people, {"count": 1, "movements": 1}),
    "failures": _Entry(failures, {"count": 2, "movements": 1}),
    "reliability": _Entry(reliability, {"takes": 1, "movements": 1}),
    "speed": _Entry(speed, {"rounds": 1}),
    "million-postures": _Entry(million_postures, {"values": 2, "people": 1}),
    "shum-tables-1-2": _Entry(shum_tables_1_2, {"people": 1, "takes": 1}),
    "shum-table-3": _Entry(shum_table_3, {"motions": 1}),
    "shum-table-4": _Entry(shum_table_4, {"takes": 1}),
    "shum-figure-8": _Entry(shum_figure_8, {"motions": 1, "values": 2}),
    "liu-figure-3": _Entry(liu_figure_3, {"people": 2, "values": 2}),
    "liu-figure-7": _Entry(liu_figure_7, {"people": 2, "values": 1}),
    "liu-figure-8": _Entry(liu_figure_8, {"people": 2}),
    "liu-table-2": _Entry(liu_table_2, {"people": 2, "motions": 1}),
    "liu-table-3": _Entry(liu_table_3, {"people": 1, "motions": 1}),
    "liu-table-4": _Entry(liu_table_4, {"people": 2, "motions": 1, "clips": 1}),
    "liu-table-5": _Entry(liu_table_5, {"people": 2, "count": 2, "clips": 2}),
    "chiang-figure-5": _Entry(chiang_figure_5, {"people": 4, "values": 4}),
    "chiang-figure-7": _Entry(chiang_figure_7, {"people": 2}),
    "chiang-table-1": _Entry(chiang_table_1, {"movements": 1}),
    "chiang-tables-2-3": _Entry(
        chiang_tables_2_3, {"people": 2, "motions": 1, "count": 1}
    ),
    "wang-figure-1": _Entry(wang_figure_1, {"frames": 241}),
    "wang-table-1": _Entry(wang_table_1, {"sizes": 2}),
    "presets": _Entry(presets, {"count": 2, "clips": 1}),
    "tracker-errors": _Entry(tracker_errors, {"clips": 1}),
    "tracker-lessons": _Entry(tracker_lessons, {"people": 4, "clips": 1}),
}
"""Every study by its name on the command line."""


def check_names(names: Sequence[str]) -> None:
    """Raise an InputError if one of the names is not that of a study."""
    for name in names:
        if name not in STUDIES:
            raise InputError(f"unknown study {name!r}; known: {', '.join(STUDIES)}")


def reproduce(name: str, options: Options, *, quick: bool = False) -> Study:
    """Run a study.

    Args:
        name: One of STUDIES.
        options: What every study is run with.
        quick: Take a small part of everything; the figures then mean little.

    Raises:
        InputError: There is no such study, or no such recordings in the folder.
    """
    check_names([name])
    run, sizes = STUDIES[name]
    return run(options, **(sizes if quick else {}))


def fingerprint(data: Path | None, *, seed: int, quick: bool) -> str:
    """Return a hash of what figures come from: source of kinefilter, and recordings.

    Recordings count by names, sizes and times. A run that was interrupted goes on with
    the studies that are missing or of another fingerprint.
    """
    found = hashlib.sha256(f"{seed} {quick}".encode())
    for floor in _FLOORS:
        folder = Path(str(resources.files(f"kinefilter.{floor}")))
        for path in sorted(folder.rglob("*")):
            if path.suffix in _SUFFIXES and path.name not in _EXCEPT:
                found.update(str(path.relative_to(folder)).encode())
                found.update(path.read_bytes())
    for path in sorted(data.rglob("*")) if data else ():
        status = path.stat()
        found.update(f"{path} {status.st_size} {status.st_mtime_ns}".encode())
    return found.hexdigest()


def is_made(name: str, folder: Path, stamp: str) -> bool:
    """Tell whether a folder holds a study's table of this fingerprint."""
    noted, table = folder / f"{name}.made", folder / f"{name}.csv"
    return table.is_file() and noted.is_file() and noted.read_text("utf-8") == stamp


def note_made(name: str, folder: Path, stamp: str) -> None:
    """Write down which fingerprint a study's table has."""
    with atomic_path(folder / f"{name}.made") as temporary:
        temporary.write_text(stamp, encoding="utf-8", newline="\n")
