"""Bodies of impossible size or place, or suddenly far away, and stray joints."""

from collections import deque
from statistics import median_low

import numpy as np

from kinefilter.characters import Body, Take
from kinefilter.characters.arrays import Array, Flags, Indices, runs
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.reliability import column_medians, segment_lengths

_TOP_SPEED = 20.0
"""Speed [m/s] beyond any person: sprinters reach 12.4 and recorded bodies 11.4, but
trackers that jump from one person to another 50 to 70."""
_NOISE = 0.5  # m by which the middle of a body may be off
# What a body may move between two frames: m, plus m/s over its lower speed before and
# after. Guesses: in 264 recorded takes six steps, at 30 Hz, are longer than 0.28 m.
_STEP, _SPURT = 0.15, 4.0
_RANGE = 20.0  # m, beyond the range of any depth sensor
_BRIEF = 0.5  # s: a body that is elsewhere for less than this was never there. A guess.
_PRIOR_FRAMES = 8  # how many frames the size of the followed body counts for. A guess.
_SIZE_FACTOR = 1.6
"""Factor by which the median segment of a frame may differ from that of the take; in
1,300 recorded clips it is 0.80 to 1.30."""
# A Kinect keeps a body for about 0.3 s after it lost the person. Chosen on p20 and p22.
_LOST = 0.3  # s without a body
_FALLEN_APART = 0.08  # median deviation of the logarithms of lengths; usually 0.01
_AFTER_LOSS = 0.6  # s that such a body may be kept; in pairs it is 0.5 at most
_AT_END = 6  # frames, of which the first three may be wrong
# m/s by which no joint changes its speed between frames and then keeps it. Chosen, from
# 7 and 8, on s07 and s08, of whose feet 7 takes some that mocap agrees with.
_JUMP = 8.0
_REACH = 2.0  # m from the middle of the body, beyond which it has no joint. A guess.
# Chosen on eight takes of pairs (p20 to p26), five of which sink; none of some 250
# others does, nor any of 1,144 clips of people who exercise.
_SUNK = 0.1  # m below the lower ankle's usual height: no hips are there
_SINKING = 0.25  # s that a body takes to sink so far, or to come up again


class ImpossibleBodies:
    """Frame-by-frame detector of bodies of another size or at an impossible place.

    A person who stays elsewhere, or stays at another size, is accepted after half a
    second; elsewhere also once they stay for longer than at the place before.
    """

    appears: bool
    """Whether the last frame is the first one accepted, at all or at another place."""
    middle: Array
    """Middle of the body in the last frame [m], shape (3,), NaN without any joint."""

    def __init__(self, body: Body) -> None:
        self._skeleton = body.skeleton
        self._lengths = np.maximum(body.lengths[self._skeleton.segments], 1e-6)
        self._sizes: deque[tuple[float, float]] = deque()  # time [s] and size
        self._last: tuple[float, Array] | None = None  # time [s] and place [m]
        self._other: tuple[float, Array] | None = None
        self._since, self._other_since = 0.0, 0.0

    def step(self, positions: Array, time: float) -> bool:
        """Return True if the body of the next frame is impossible.

        Joint positions [m], shape (J, 3), are NaN where missing; a frame without any
        joint is not impossible. The time stamp is in s.
        """
        self.appears = False
        self.middle = place = _lower_median(positions)
        if np.isnan(place[0]):
            return False
        lengths = segment_lengths(positions, self._skeleton)[self._skeleton.segments]
        size = float(_lower_median(lengths / self._lengths))
        if not np.isnan(size):
            sizes = self._sizes = self._sizes or deque([(time, 1.0)] * _PRIOR_FRAMES)
            while sizes and sizes[0][0] < time - 2.0 * _BRIEF:
                sizes.popleft()
            sizes.append((time, size))
            usual = median_low(s for _, s in sizes)
            if not usual / _SIZE_FACTOR <= size <= usual * _SIZE_FACTOR:
                return True
        return self._is_elsewhere(time, place)

    def _is_elsewhere(self, time: float, place: Array) -> bool:
        if _is_reachable(self._last, time, place):
            self._last, self._other = (time, place), None
            return False
        if not _is_reachable(self._other, time, place):
            self._other_since = time
        self._other = time, place
        stayed = 0.0 if self._last is None else self._last[0] - self._since
        if time - self._other_since < min(stayed, _BRIEF):
            return True
        self._last, self._other, self._since = self._other, None, time
        self.appears = True
        return False


def _is_reachable(seen: tuple[float, Array] | None, time: float, place: Array) -> bool:
    if seen is None:
        return False
    distance = np.asarray(np.linalg.norm(place - seen[1]))
    return bool(_reachable(distance, time - seen[0]))


def _lower_median(values: Array) -> Array:
    """Return the lower median along axis 0 without NaN; ``np.nanmedian`` is slow."""
    ordered = np.sort(values, axis=0)
    known = np.count_nonzero(ordered == ordered) // max(ordered[0].size, 1)
    return np.asarray(ordered[max(known - 1, 0) // 2])


def wrong_size_frames(take: Take) -> Flags:
    """Return the frames in which the body has a size that is not its own, (T,)."""
    lengths = segment_lengths(take.positions, take.skeleton)[:, take.skeleton.segments]
    sizes = lengths / np.maximum(column_medians(lengths), 1e-6)
    size = np.nan_to_num(column_medians(sizes.T), nan=1.0)
    return np.asarray((size > _SIZE_FACTOR) | (size < 1.0 / _SIZE_FACTOR))


def fallen_apart_frames(take: Take) -> Flags:
    """Return the last frames before a loss of the body, if it is no longer one, (T,).

    Behind somebody else, for one, it keeps moving for a moment without any measurement.
    """
    skeleton, time, wrong = take.skeleton, take.time, np.zeros(len(take), dtype=bool)
    long = [j for j in skeleton.segments if not skeleton.hands[j]]
    lengths = np.maximum(segment_lengths(take.positions, skeleton)[:, long], 1e-6)
    ratios = np.abs(np.log(lengths / np.maximum(column_medians(lengths), 1e-6)))
    odd = np.nan_to_num(column_medians(ratios.T)) > _FALLEN_APART
    there = np.flatnonzero(~np.isnan(take.positions).all(axis=(1, 2)))
    for last in np.flatnonzero(np.diff(time[there]) > _LOST):
        sound = np.flatnonzero(~odd[there[: last + 1]])
        if len(sound) and sound[-1] < last:
            since = there[sound[-1] + 1 : last + 1]
            # If it is odd for longer, it may just be seen from the side.
            wrong[since] = time[since[-1]] - time[since[0]] < _AFTER_LOSS
    return wrong


def stray_joints(positions: Array, middle: Array) -> Flags:
    """Return True for joints too far from the body's middle [m] to be its, (..., J)."""
    away = positions - middle[..., None, :]
    return np.asarray(np.vecdot(away, away) > _REACH**2)


def jumps_at_ends(take: Take) -> Flags:
    """Return True for joints that were elsewhere in the first or last frames, (T, J).

    Up to three frames, of each part between long gaps. In between, smoothing evens out
    most of what is as brief.
    """
    wrong, time, path = np.zeros(take.state.shape, bool), take.time, take.positions
    least = 0.5 * nominal_step(time)  # time stamps may tremble
    for part in parts_of(time):
        frames = np.arange(len(time))[part]
        for some in (frames[:_AT_END], frames[::-1][:_AT_END]):
            if len(some) == _AT_END:
                seconds = np.maximum(np.abs(np.diff(time[some])), least)
                speeds = np.diff(path[some], axis=0) / seconds[:, None, None]
                change = np.linalg.norm(np.diff(speeds, axis=0), axis=2)
                jump = (change[:-1] > _JUMP) & (change[1:] < change[:-1] / 3.0)
                # All frames before the last jump.
                jump = np.logical_or.accumulate(jump[::-1])[::-1]
                wrong[some[: len(jump)]] |= jump
    return wrong


def sunken_frames(take: Take) -> Flags:
    """Return the frames in which the body briefly sinks through the floor, (T,)."""
    skeleton, time = take.skeleton, take.time
    hips = take.positions[:, skeleton.root, 1]
    ankles = take.positions[:, list(skeleton.sides("Ankle")), 1]
    sunken = np.zeros(len(take), dtype=bool)
    if np.isnan(ankles).all():
        return sunken
    usual = np.nanpercentile(np.fmin(*ankles.T), 10.0)
    known = np.flatnonzero(~np.isnan(hips))
    for run in runs(hips[known] < usual - _SUNK):
        first, last = time[known[run]][[0, -1]]
        if last - first < _BRIEF:
            sunken |= (time > first - _SINKING) & (time < last + _SINKING)
    return sunken


def middles(positions: Array) -> Array:
    """Return the middle of the body [m] in each frame, shape (T, 3)."""
    by_joint = positions.transpose(1, 0, 2).reshape(positions.shape[1], -1)
    return column_medians(by_joint).reshape(-1, 3)


def misplaced_frames(take: Take) -> tuple[Flags, Flags]:
    """Return the frames with the body at an impossible place, and where it jumps, (T,).

    Frames between two jumps are impossible if they are brief or out of the sensor's
    range; otherwise the body continues there: trackers do jump to another person.
    """
    wrong, jumps = np.zeros((2, len(take)), dtype=bool)
    middle = middles(take.positions)
    known = np.flatnonzero(~np.isnan(middle[:, 0]))
    if not len(known):
        return wrong, jumps
    places, joints, time = middle[known], take.positions[known], take.time[known]

    def distance(first: Indices, last: Indices) -> Array:
        """Return how far the body moves at least [m], (N,).

        Its middle seems to move where legs leave the view, but not its other joints.
        """
        moves = places[last] - places[first], middles(joints[last] - joints[first])
        return np.asarray(np.fmin(*np.linalg.norm(moves, axis=-1)))

    there = np.arange(len(known))
    steps = distance(there[:-1], there[1:]) / np.maximum(np.diff(time), 1e-9)
    speeds = np.pad(steps, 1, mode="edge") if len(steps) else np.zeros(2)

    def gets_there(first: Indices, last: Indices) -> Flags:
        """Return True where the person can get from one frame to the other, (N,)."""
        seconds, far = time[last] - time[first], distance(first, last)
        usual = np.minimum(speeds[first], speeds[last + 1]) + _SPURT
        return np.asarray((far < _STEP + usual * seconds) & _reachable(far, seconds))

    pieces = np.split(there, 1 + np.flatnonzero(~gets_there(there[:-1], there[1:])))
    longest = int(np.argmax([len(piece) for piece in pieces]))
    # From the longest piece to the end of the take, then to its beginning.
    for way in (pieces[longest:], [p[::-1] for p in pieces[longest::-1]]):
        last = way[0][-1]
        for piece in way[1:]:
            ends = np.sort([[last], [piece[0]]], axis=0)
            if not gets_there(*ends).all():
                far = distance(*ends)[0] > _RANGE
                if far or np.ptp(time[piece]) < _BRIEF:
                    wrong[known[piece]] = True
                    continue
                jumps[known[[last, piece[0]]]] = True
            last = piece[-1]
    return wrong, jumps


def _reachable(distances: Array, seconds: Array | float) -> Flags:
    """Return True where a person can get that far [m] in time."""
    return np.asarray(distances < _NOISE + np.minimum(_TOP_SPEED * seconds, _RANGE))
