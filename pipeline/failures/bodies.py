"""Bodies in places that nobody reaches so fast, and of sizes that nobody has."""

from __future__ import annotations

from collections import deque
from statistics import median_low

import numpy as np

from kinefilter.characters import Body, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.reliability import column_medians, segment_lengths

_FASTEST = 20.0
"""Speed [m/s] that nobody has: sprinters reach 12.4, recorded bodies 11.4 in a frame,
and 50 to 70 where a tracker takes one person for another."""
_STEP = 0.5  # m within which a body's middle may be noisy
_RANGE = 20.0  # m that no depth sensor sees
_BRIEF = 0.5  # s: who is elsewhere for less was not there. A guess.
_KNOWN = 8  # frames for which the size of the body counts that is followed. A guess.
_ODDEST = 1.6
"""Factor by which the segments of a frame, their median, may be off those of the take;
in 1,300 recorded clips 0.80 to 1.30."""


class ImpossibleBodies:
    """Tells, frame by frame, bodies of another size or where nobody gets so fast.

    Going by the past alone: who stays elsewhere, or of another size, is believed after
    half a second, and as soon as they are there for longer than they were before.
    ``appears`` then says that of this frame, as it does of the first that is believed.

    Args:
        body: The person.
    """

    appears: bool
    """Whether the last frame is the first one in which the person is where they are."""

    def __init__(self, body: Body) -> None:
        segments = body.skeleton.segments
        self._segments, self._parents = segments, body.skeleton.segment_parents
        self._lengths = np.maximum(body.lengths[segments], 1e-6)
        self._sizes: deque[tuple[float, float]] = deque()
        self._last: tuple[float, Array] | None = None  # time [s] and place [m]
        self._other: tuple[float, Array] | None = None
        self._since, self._other_since = 0.0, 0.0

    def step(self, positions: Array, time: float) -> bool:
        """Return whether nobody can be so, at joint positions [m], (J, 3), at a time.

        Frames without a joint are no such.
        """
        self.appears = False
        place = _median(positions)
        if np.isnan(place[0]):
            return False
        bones = positions[self._segments] - positions[self._parents]
        size = float(_median(np.sqrt(np.vecdot(bones, bones)) / self._lengths))
        return self._is_odd(size, time) or self._is_elsewhere((time, place))

    def _is_odd(self, size: float, time: float) -> bool:
        if np.isnan(size):
            return False
        sizes = self._sizes
        if not sizes:
            sizes.extend([(time, 1.0)] * _KNOWN)
        while sizes and sizes[0][0] < time - 2.0 * _BRIEF:
            sizes.popleft()
        sizes.append((time, size))
        usual = median_low(s for _, s in sizes)
        return not usual / _ODDEST <= size <= usual * _ODDEST

    def _is_elsewhere(self, now: tuple[float, Array]) -> bool:
        time, _ = now
        if self._last is not None and _gets(self._last, now):
            self._last, self._other = now, None
            return False
        if self._other is None or not _gets(self._other, now):
            self._other_since = time
        self._other = now
        was_there = 0.0 if self._last is None else self._last[0] - self._since
        if time - self._other_since < min(was_there, _BRIEF):
            return True
        self._last, self._other, self._since = now, None, time
        self.appears = True
        return False


def _gets(last: tuple[float, Array], now: tuple[float, Array]) -> bool:
    return bool(_reached(last[1], now[1], np.asarray(now[0] - last[0])))


def _median(values: Array) -> Array:
    """Return the lower median of rows without NaN, NaN where all have it.

    For a few rows, of which numpy's own would take five times as long.
    """
    ordered = np.sort(values, axis=0)
    known = np.count_nonzero(ordered == ordered) // max(ordered[0].size, 1)
    return np.asarray(ordered[max(known - 1, 0) // 2])


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
