"""The built-in motion database, built from scripted performances.

``kinefilter database build --scripted`` writes it; the result ships in
``pipeline/embedded``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.scenes.library import MOTIONS, perform, random_body

from .database_build import POSTURES_PER_SECOND, filtered_database, standard_postures

BUILTIN_POSTURES = 5000
"""Approximate size of the built-in database: twice that of Shum et al., so that half of
the postures in real mocap are within 8 cm of one."""
_PEOPLE = 6


def scripted_database(
    skeleton: Skeleton, progress: Progress = silent
) -> PostureDatabase:
    """Perform every scripted motion and keep postures that differ."""
    parts = scripted_postures(skeleton, progress)
    return filtered_database(
        parts, skeleton, "built-in", BUILTIN_POSTURES, recorded=False
    )


def scripted_postures(
    skeleton: Skeleton, progress: Progress = silent, *, people: int = _PEOPLE
) -> Iterator[tuple[str, Array, Array]]:
    """Yield the name, postures and segment rotations of every scripted performance.

    The performers differ in height and build; the postures are on the standard body, 30
    a second.
    """
    # All motions by one person, then by the next: the filter keeps earlier postures.
    for k in progress("motion database", people * len(MOTIONS)):
        seed, name = k // len(MOTIONS), MOTIONS[k % len(MOTIONS)]
        body = random_body(skeleton, np.random.default_rng(seed))
        act = perform(name, body, seed=seed, fps=POSTURES_PER_SECOND)
        yield name, *standard_postures(act.positions, act.rotations, body)
