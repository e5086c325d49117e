"""The studies by name, in full size and in small."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from kinefilter.characters import InputError
from kinefilter.pipeline.progress import Progress, silent

from .chiang import chiang_figure_5
from .liu import liu_figure_3, liu_figure_7, liu_table_5
from .reliability import reliability
from .shum_parameters import shum_figure_8
from .shum_reconstruction import shum_table_3, shum_table_4
from .study import Study

__all__ = ["STUDIES", "check_names", "reproduce"]


class _Entry(NamedTuple):
    """A study and the sizes that make it quick."""

    run: Callable[..., Study]
    quick: dict[str, int]


STUDIES: dict[str, _Entry] = {
    "shum-table-3": _Entry(shum_table_3, {"motions": 1}),
    "shum-table-4": _Entry(shum_table_4, {"takes": 1}),
    "shum-figure-8": _Entry(shum_figure_8, {"motions": 1, "values": 2}),
    "liu-figure-3": _Entry(liu_figure_3, {"people": 2, "values": 2}),
    "liu-figure-7": _Entry(liu_figure_7, {"people": 2, "values": 1}),
    "liu-table-5": _Entry(liu_table_5, {"people": 2}),
    "chiang-figure-5": _Entry(chiang_figure_5, {"people": 4, "values": 4}),
    "reliability": _Entry(reliability, {"takes": 1}),
}
"""Every study by its name on the command line."""


def check_names(names: Sequence[str]) -> None:
    """Raise an InputError if there is no study of one of the names."""
    for name in names:
        if name not in STUDIES:
            raise InputError(f"unknown study {name!r}; known: {', '.join(STUDIES)}")


def reproduce(
    name: str, *, seed: int = 0, quick: bool = False, progress: Progress = silent
) -> Study:
    """Run a study.

    Args:
        name: One of STUDIES.
        seed: Draws people, performances and the sensor's errors.
        quick: Take a small part of everything; the figures then mean little.
        progress: Wraps the loops, for a progress bar.

    Raises:
        InputError: There is no such study.
    """
    check_names([name])
    run, sizes = STUDIES[name]
    return run(seed=seed, progress=progress, **(sizes if quick else {}))
