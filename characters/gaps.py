"""Long gaps: intervals without a frame that no stage bridges."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from .arrays import Array, Flags

LONG_GAP = 2.0
"""Longest time between frames [s] across which motion counts as continuous. A guess:
two seconds later, a limb's earlier movement no longer says where it is, and none of 99
recorded takes has half a second without a frame."""
_MOST_LISTED = 5  # gaps of a take; the rest are only counted


def parts_of(time: Array) -> list[slice]:
    """Return the frames between long gaps; time stamps [s] (T,) never decrease."""
    starts = np.flatnonzero(np.diff(time) > LONG_GAP) + 1
    return [slice(a, b) for a, b in pairwise([0, *starts.tolist(), len(time)])]


def long_gaps(time: Array) -> list[tuple[float, float]]:
    """Return the last time stamp before each long gap and the first after it [s]."""
    pairs = pairwise(parts_of(time))
    return [(float(time[a.stop - 1]), float(time[b.start])) for a, b in pairs]


def absences(time: Array, seen: Flags) -> Flags:
    """Return the frames in which nobody is ``seen`` (T,) for longer than a long gap.

    Before the first frame with somebody and after the last one, too; (T,).
    """
    rows, frames = np.flatnonzero(seen), np.arange(len(time))
    stamps = np.concatenate([time[:1], time[rows], time[-1:]])
    before = stamps[np.searchsorted(rows, frames, "right")]
    after = stamps[np.searchsorted(rows, frames) + 1]
    return np.asarray(~seen & (after - before > LONG_GAP))


def describe_gaps(
    gaps: Sequence[tuple[float, float]], begin: float, then: str = ""
) -> list[str]:
    """Return a line on each of the first few long gaps, followed by ``then``.

    Times are relative to ``begin``, the time stamp of the first frame [s].
    """
    lines = [
        f"no frames from {start - begin:.1f} to {end - begin:.1f} s "
        f"({end - start:.4g} s){then}"
        for start, end in gaps[:_MOST_LISTED]
    ]
    more = len(gaps) - len(lines)
    return lines + [f"and {more} more such gaps"] * (more > 0)
