"""Bodies in places that nobody reaches so fast, and of sizes that nobody has."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.reliability import column_medians, segment_lengths

_FASTEST = 20.0
"""Speed [m/s] that nobody has: sprinters reach 12.4, recorded bodies 11.4 in a frame,
and 50 to 70 where a tracker takes one person for another."""
_STEP = 0.5  # m within which a body's middle may be noisy
_RANGE = 20.0  # m that no depth sensor sees
_BRIEF = 0.5  # s: who is elsewhere for less was not there. A guess.
_ODDEST = 1.6
"""Factor by which the segments of a frame, their median, may be off those of the take;
in 1,300 recorded clips 0.80 to 1.30."""


def of_another_size(take: Take) -> Flags:
    """Return the frames in which the body has a size that is not its own, (T,)."""
    lengths = segment_lengths(take.positions, take.skeleton)
    lengths = lengths[:, take.skeleton.segments]
    share = lengths / np.maximum(column_medians(lengths), 1e-6)
    share = np.nan_to_num(column_medians(share.T), nan=1.0)
    return np.asarray((share > _ODDEST) | (share < 1.0 / _ODDEST))


def elsewhere(take: Take) -> tuple[Flags, Flags]:
    """Return the frames in which a body is where it cannot be, and where it jumps.

    Both have shape (T,). What lies between two jumps is elsewhere if it is brief or out
    of a sensor's range; if not, the body goes on from there, as trackers take one
    person for another.
    """
    wrong, jumps = np.zeros((2, len(take)), dtype=bool)
    middle = column_medians(
        take.positions.transpose(1, 0, 2).reshape(len(take.skeleton), -1)
    )
    middle = middle.reshape(-1, 3)
    known = np.flatnonzero(~np.isnan(middle[:, 0]))
    if len(known) < 2:
        return wrong, jumps
    places, time = middle[known], take.time[known]
    breaks = 1 + np.flatnonzero(~_reached(places[:-1], places[1:], np.diff(time)))
    if not len(breaks):
        return wrong, jumps
    pieces = np.split(np.arange(len(known)), breaks)
    longest = int(np.argmax([len(piece) for piece in pieces]))
    # From the longest piece on, to the end of the take and to its beginning.
    for way in (pieces[longest:], [p[::-1] for p in pieces[longest::-1]]):
        last = way[0][-1]
        for piece in way[1:]:
            gap = np.abs(time[piece[0]] - time[last])
            if not _reached(places[last], places[piece[0]], gap):
                far = np.linalg.norm(places[piece[0]] - places[last]) > _RANGE
                if far or np.ptp(time[piece]) < _BRIEF:
                    wrong[known[piece]] = True
                    continue
                jumps[known[[last, piece[0]]]] = True
            last = piece[-1]
    return wrong, jumps


def _reached(start: Array, end: Array, seconds: Array) -> Flags:
    """Return whether a body gets from places to others [m], (..., 3), in a time."""
    away = np.linalg.norm(end - start, axis=-1)
    return np.asarray(away < _STEP + np.minimum(_FASTEST * seconds, _RANGE))
