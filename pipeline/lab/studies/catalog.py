"""The studies by name, in full size and in small."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress, silent

from .chiang import chiang_figure_5
from .cleaned_takes import cleaned_takes
from .failures import failures
from .liu import liu_figure_3, liu_figure_7, liu_table_5
from .marker_mocap import marker_mocap
from .methods import methods_known_people, methods_new_people, untrained
from .million_postures import million_postures
from .reliability import reliability
from .shum_parameters import shum_figure_8
from .shum_reconstruction import shum_table_3, shum_table_4
from .speed import speed
from .study import Study


class _Entry(NamedTuple):
    """A study and the sizes that make it quick."""

    run: Callable[..., Study]
    quick: dict[str, int]
    recorded: bool = False
    """Whether it asks for recordings."""


STUDIES: dict[str, _Entry] = {
    "cleaned-takes": _Entry(cleaned_takes, {"count": 2}, recorded=True),
    "marker-mocap": _Entry(marker_mocap, {"movements": 1}, recorded=True),
    "untrained": _Entry(untrained, {"count": 2, "movements": 1}, recorded=True),
    "methods-new-people": _Entry(
        methods_new_people, {"count": 2, "movements": 1}, recorded=True
    ),
    "methods-known-people": _Entry(
        methods_known_people, {"count": 1, "movements": 1}, recorded=True
    ),
    "failures": _Entry(failures, {"count": 2, "movements": 1}, recorded=True),
    "reliability": _Entry(reliability, {"takes": 1, "movements": 1}, recorded=True),
    "speed": _Entry(speed, {"rounds": 1}),
    "million-postures": _Entry(million_postures, {"values": 2, "people": 1}),
    "shum-table-3": _Entry(shum_table_3, {"motions": 1}),
    "shum-table-4": _Entry(shum_table_4, {"takes": 1}),
    "shum-figure-8": _Entry(shum_figure_8, {"motions": 1, "values": 2}),
    "liu-figure-3": _Entry(liu_figure_3, {"people": 2, "values": 2}),
    "liu-figure-7": _Entry(liu_figure_7, {"people": 2, "values": 1}),
    "liu-table-5": _Entry(liu_table_5, {"people": 2}),
    "chiang-figure-5": _Entry(chiang_figure_5, {"people": 4, "values": 4}),
}
"""Every study by its name on the command line."""


def check_names(names: Sequence[str]) -> None:
    """Raise an InputError if there is no study of one of the names."""
    for name in names:
        if name not in STUDIES:
            raise InputError(f"unknown study {name!r}; known: {', '.join(STUDIES)}")


def reproduce(
    name: str,
    *,
    seed: int = 0,
    quick: bool = False,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Run a study.

    Args:
        name: One of STUDIES.
        seed: Draws people, performances and the sensor's errors.
        quick: Take a small part of everything; the figures then mean little.
        data: Folder of recordings; None: simulated takes alone.
        progress: Wraps the loops, for a progress bar.

    Raises:
        InputError: There is no such study, or no such recordings in the folder.
    """
    check_names([name])
    run, sizes, recorded = STUDIES[name]
    more: dict[str, Any] = {"data": data} if recorded else {}
    return run(seed=seed, progress=progress, **(sizes if quick else {}), **more)
