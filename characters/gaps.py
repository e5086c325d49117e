"""Long gaps: stretches of time without a frame, which nothing looks across."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from .arrays import Array

LONG_GAP = 2.0
"""Time without a frame [s] from which on what comes after does not go on from before. A
guess: where a limb is two seconds later, its movement no longer says, and none of 99
recorded takes has half a second without a frame."""
_TOLD = 5  # of a take; of more their number says enough


def parts_of(time: Array) -> list[slice]:
    """Return the frames between long gaps; time stamps [s] (T,) never decrease."""
    starts = np.flatnonzero(np.diff(time) > LONG_GAP) + 1
    return [slice(a, b) for a, b in pairwise([0, *starts.tolist(), len(time)])]


def long_gaps(time: Array) -> list[tuple[float, float]]:
    """Return the last time stamp before each long gap and the first after it [s]."""
    pairs = pairwise(parts_of(time))
    return [(float(time[a.stop - 1]), float(time[b.start])) for a, b in pairs]


def told_gaps(
    gaps: Sequence[tuple[float, float]], begin: float, then: str = ""
) -> list[str]:
    """Return what users read about long gaps, the first few, and what ``then`` is.

    Times are since ``begin``, the time stamp of the first frame [s].
    """
    lines = [
        f"no frames from {start - begin:.1f} to {end - begin:.1f} s "
        f"({end - start:.4g} s){then}"
        for start, end in gaps[:_TOLD]
    ]
    more = len(gaps) - len(lines)
    return lines + [f"and {more} more such gaps"] * (more > 0)
