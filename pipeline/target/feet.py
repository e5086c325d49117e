"""When each foot stands; it then stays where it is, and is lifted where it steps.

Time stamps [s] are strictly increasing, shape (T,); joint positions [m] have y up and
shape (T, J, 3); the confidence of joints has shape (T, J); whether each foot stands has
shape (T, 2), left and right.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.retarget.stance import smooth_step

from .smooth import smooth

_CUTOFF = 3.0  # Hz: slower than Kinect's noise in the feet, faster than stances
_LEAST_WEIGHT = 0.1  # of an invented ankle in the smoother, against a measured one's 1
# Log odds of standing, by logistic regression on simulated takes (51 motions, of people
# and seeds of their own). On six recorded people the area under ROC is 0.99.
_STANDS = 4.0
_PER_SPEED = 5.0  # per m/s of the ankle. Upwards too: who jumps lifts both at once.
_PER_LIFT = 15.0  # per m that the ankle is higher than the other
_PER_HEIGHT = 12.0  # per m that both are over what Kinect's errors in squats lift them
_LOWER, _HIGHER = -0.1, 0.3  # m: heights are clipped to this range
_ERROR_OF_HEIGHT = 0.1  # m
_STANDING = 20.0  # percentile of the ankles' heights that is taken for standing
_SWITCH = 4.0  # what a change costs, in the same unit: the hysteresis. A guess.
_SPEED_TIME = 0.1  # s that a speed is a mean over where nobody looks ahead
_RATE = 30.0  # Hz of the takes it is for: more frames a second say no more
_DRIFT = 0.10  # m: an ankle that moved farther has made a step that nobody saw
_UNLOADING = 0.15  # s: from the first rise of a foot to its leaving
_STEP = 0.3  # s: how long such a step takes

PLANTED = 120.0
"""Firmness of a standing foot where bones ask for a move; a measured joint has 1."""
_HEEL_ERROR = 0.10  # m: a standing ankle that is higher than this has left the floor
_HEEL_DOWN = 0.01  # m that a heel rises and still counts as down
_LIFT_TIME = 0.1  # s: to lift a foot that high, and to set it down
_SLIDE_SPEED = 0.15  # m/s: a foot that is faster is lifted
_CLEARANCE = 0.065  # m between the floor and a sole that moves. People walk with less,
# but a viewer takes what is lower for sliding.
_HOLD = 0.08  # s that a foot stays over its place while it is lifted or set down
_CATCH_UP = 0.15  # s in which it joins the measured path then
_FIRM = 1e4  # weight of a standing foot in the smoother, against a step's 1
_STEP_CUTOFF = 6.0  # Hz: what rounds the corners of steps


def ankles_and_toes(skeleton: Skeleton) -> tuple[list[int], list[int]]:
    """Return the indices of the ankles and of the feet, left and right."""
    return skeleton.sides("Ankle"), skeleton.sides("Foot")


def find_stance(
    time: Array, positions: Array, confidence: Array, skeleton: Skeleton
) -> Flags:
    """Return whether each foot stands in each frame, shape (T, 2), left and right.

    A foot stands while its ankle rests and is no higher than the other's. The most
    probable sequence of standing and stepping is taken, where every change costs
    something: Viterbi's algorithm, which is a hysteresis that looks ahead.
    """
    ankles, _ = ankles_and_toes(skeleton)
    weights = np.maximum(confidence[:, ankles], _LEAST_WEIGHT)
    paths = smooth(time, positions[:, ankles], weights, cutoff=_CUTOFF)
    speed, step, height = np.zeros(paths.shape[:2]), 1.0 / _RATE, paths[..., 1]
    if len(time) > 1:
        speed = np.linalg.norm(np.gradient(paths, time, axis=0), axis=2)
        step = float(np.median(np.diff(time)))
    above = height - np.percentile(height, _STANDING) - _ERROR_OF_HEIGHT
    stands = _most_probable(_RATE * step * _odds(speed, height, above))
    for foot in range(2):
        for stance in runs(stands[:, foot]):
            _split(time, paths[:, foot][:, [0, 2]], stands[:, foot], stance)
    return _unloaded(time, stands)


def feet_of(contacts: Flags) -> Flags:
    """Return whether each foot stands, (T, 2), from its parts (CONTACTS), (T, 4)."""
    return np.asarray(contacts.reshape(-1, 2, 2).any(axis=2))


def _odds(speed: Array, height: Array, above: Array) -> Array:
    """Return the log odds of standing, shape (..., 2)."""
    lift = np.clip(height - height[..., ::-1], _LOWER, _HIGHER)
    above = np.clip(above, 0.0, _HIGHER)
    speed = np.minimum(speed, 1.0)
    return np.asarray(
        _STANDS - _PER_SPEED * speed - _PER_LIFT * lift - _PER_HEIGHT * above
    )


def _most_probable(log_odds: Array) -> Flags:
    """Return the most probable sequence of two states; each change costs _SWITCH."""
    count = len(log_odds)
    # Only the lead of standing over stepping counts: it is capped by what a change
    # costs, and what caps it says where the best sequence came from.
    lead = np.empty_like(log_odds)
    lead[0] = log_odds[0]
    for k in range(1, count):
        lead[k] = np.clip(lead[k - 1], -_SWITCH, _SWITCH) + log_odds[k]
    stands = np.empty(log_odds.shape, dtype=np.bool_)
    stands[-1] = lead[-1] > 0.0
    for k in range(count - 2, -1, -1):
        stands[k] = np.where(stands[k + 1], lead[k] > -_SWITCH, lead[k] > _SWITCH)
    return stands


class StanceTracker:
    """Tells frame by frame, without looking ahead, whether each foot stands.

    The same odds as ``find_stance``; a change has to gather as much evidence as it
    costs there, and speeds are means over a tenth of a second.
    """

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._paths: Array | None = None
        self._lead = np.full(2, _SWITCH)
        self.stands = np.ones(2, dtype=np.bool_)
        """Whether each foot stands, left and right, shape (2,)."""

    def step(self, ankles: Array, flat: float, dt: float) -> Flags:
        """Take in the next frame and return whether each foot stands, shape (2,).

        Args:
            ankles: Positions of the ankles [m], floor at y = 0, shape (2, 3).
            flat: Height of the ankle of a foot that is flat on the floor [m].
            dt: Time since the last frame [s].
        """
        if self._paths is None:
            self._paths = ankles.copy()
        share = 1.0 - np.exp(-dt / _SPEED_TIME)
        moved = share * (ankles - self._paths)
        self._paths = self._paths + moved
        speed = np.linalg.norm(moved, axis=1) / dt
        height = self._paths[:, 1]
        odds = _odds(speed, height, height - flat - _ERROR_OF_HEIGHT)
        self._lead = np.clip(self._lead + odds * dt * _RATE, -_SWITCH, _SWITCH)
        self.stands = np.where(
            self.stands, self._lead > -_SWITCH, self._lead >= _SWITCH
        )
        return self.stands


def _unloaded(time: Array, stands: Flags) -> Flags:
    """Return stances shortened by the time to set the foot down and to lift it."""
    shorter = stands.copy()
    for foot in range(2):
        for stance in runs(stands[:, foot]):
            share = time[stance.stop - 1] - time[stance.start]
            margin = min(_UNLOADING, 0.25 * share)
            if stance.start > 0:
                begun = time[stance.start] + margin - 1e-9
                shorter[stance.start : np.searchsorted(time, begun), foot] = False
            if stance.stop < len(time):
                ends = time[stance.stop - 1] - margin + 1e-9
                shorter[np.searchsorted(time, ends) : stance.stop, foot] = False
    return shorter


def _split(time: Array, path: Array, stands: Flags, stance: slice) -> None:
    """Split a stance (in place) during which the foot moved to another place."""
    points = path[stance]
    count = len(points)
    if count < 4:
        return
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    if away.max() < _DRIFT:
        return
    # The frame that best divides the path between two resting places.
    sums = np.cumsum(points, axis=0)
    k = np.arange(1, count)[:, None]
    gain = np.sum(
        sums[:-1] ** 2 / k + (sums[-1] - sums[:-1]) ** 2 / (count - k), axis=1
    )
    middle = stance.start + 1 + int(gain.argmax())
    first = int(np.searchsorted(time, time[middle] - 0.5 * _STEP))
    last = int(np.searchsorted(time, time[middle] + 0.5 * _STEP))
    first, last = max(first, stance.start), min(last, stance.stop)
    stands[first:last] = False
    for part in (slice(stance.start, first), slice(last, stance.stop)):
        _split(time, path, stands, part)


def plant_feet(
    time: Array,
    positions: Array,
    confidence: Array,
    stands: Flags,
    body: Body,
    heels: Flags | None = None,
) -> tuple[Array, Flags]:
    """Return positions (T, J, 3) whose feet rest while they stand, and their heels.

    Ankle and toes of a standing foot stay in one place, that of their weighted median,
    the sole on the floor; the heel rises only where the ankle is higher than Kinect's
    errors lift it. A foot that steps follows the measurement, moved so that it leaves
    and arrives where it stands, and lifted where it is fast.

    The floor is at y = 0. Heels, shape (T, 2), are down in any case where they are
    given to be, elsewhere as found; the second result says where, shape (T, 2).
    """
    planted, down = positions.copy(), np.zeros_like(stands)
    feet = zip(*ankles_and_toes(body.skeleton), strict=True)
    for foot, (ankle, toe) in enumerate(feet):
        stances = runs(stands[:, foot])
        if not stances:
            continue
        path = positions[:, [ankle, toe]]
        flat = flat_height(body, toe)
        rise = np.maximum(path[:, 0, 1] - flat - _HEEL_ERROR, 0.0)
        if heels is not None:
            rise[heels[:, foot]] = 0.0
        down[:, foot] = stands[:, foot] & (rise < _HEEL_DOWN)
        resting = [
            _resting(path[s], confidence[s, ankle], rise[s], body, toe) for s in stances
        ]
        path = _joined(time, path, resting, stances)
        path[:, :, 1] += _lift(time, path[:, 1], body.radii[toe], stands[:, foot])
        firm = np.where(stands[:, [foot, foot]], _FIRM, 1.0)
        planted[:, [ankle, toe]] = smooth(time, path, firm, cutoff=_STEP_CUTOFF)
    return planted, down


def flat_height(body: Body, toe: int) -> float:
    """Return the height [m] of the ankle of a foot that is flat on the floor."""
    ankle = float(body.rest_positions[body.skeleton.parents[toe], 1])
    return min(ankle, float(body.radii[toe] + body.lengths[toe]))


def _resting(path: Array, weights: Array, rise: Array, body: Body, toe: int) -> Array:
    """Return ankle and toe of one stance [m], shape (T, 2, 3)."""
    place = [_median(path[:, 0, axis], weights) for axis in (0, 2)]
    ahead = np.median(path[:, 1] - path[:, 0], axis=0)[[0, 2]]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    length, sole = body.lengths[toe], body.radii[toe]
    flat = flat_height(body, toe)
    reach = np.sqrt(max(length**2 - (flat - sole) ** 2, 0.0))
    rest = np.zeros((len(path), 2, 3))
    rest[:, 1, [0, 2]] = place + reach * ahead
    rest[:, 1, 1] = sole
    # The ankle turns about the toes.
    height = np.minimum(flat + rise, sole + length)
    back = np.sqrt(np.maximum(length**2 - (height - sole) ** 2, 0.0))
    rest[:, 0, [0, 2]] = rest[:, 1][:, [0, 2]] - back[:, None] * ahead
    rest[:, 0, 1] = height
    return rest


def _joined(
    time: Array, path: Array, resting: list[Array], stances: list[slice]
) -> Array:
    """Return stances and the steps between them [m], shape (T, 2, 3).

    A step is the measured one, moved; while the foot is lifted and set down it stays
    over the place where it stands.
    """
    joined = np.empty_like(path)
    moves = [r - path[s] for r, s in zip(resting, stances, strict=True)]
    for rest, stance in zip(resting, stances, strict=True):
        joined[stance] = rest
    # Before the first stance and after the last there is only one end to fit.
    ends = [None, *range(len(stances)), None]
    for before, after in pairwise(ends):
        first = 0 if before is None else stances[before].stop
        last = len(path) if after is None else stances[after].start
        if first == last:
            continue
        gap = slice(first, last)
        leave = np.zeros((1, 2, 3)) if before is None else moves[before][-1]
        arrive = leave if after is None else moves[after][0]
        leave = arrive if before is None else leave
        step = path[gap] + leave
        if before is not None and after is not None:
            over = time[gap] - time[first - 1]
            share = _ease(over / (time[last] - time[first - 1]))
            step = step + share * (arrive - leave)
        if before is not None:
            free = _ease((time[gap] - time[first - 1] - _HOLD) / _CATCH_UP)
            step = free * step + (1.0 - free) * joined[first - 1]
        if after is not None:
            free = _ease((time[last] - time[gap] - _HOLD) / _CATCH_UP)
            step = free * step + (1.0 - free) * joined[last]
        joined[gap] = step
    return joined


def _lift(time: Array, toe: Array, sole: float, stands: Flags) -> Array:
    """Return by how much a foot is lifted in each frame [m], shape (T, 1)."""
    steps = np.diff(time)
    speed = np.linalg.norm(np.diff(toe[:, [0, 2]], axis=0), axis=1) / steps
    fast = np.concatenate([[0.0], speed]), np.concatenate([speed, [0.0]])
    needed = np.where(np.maximum(*fast) > _SLIDE_SPEED, _CLEARANCE, 0.0)
    needed[stands] = 0.0
    # Up and down at an even speed, which needs frames before and after.
    slopes = _CLEARANCE / _LIFT_TIME * steps
    edge = np.where(stands, 0.0, np.inf)
    for way in (1, -1):
        low, high, slope = edge[::way], needed[::way], slopes[::way]
        for k in range(1, len(time)):
            low[k] = min(low[k], low[k - 1] + slope[k - 1])
            high[k] = max(high[k], high[k - 1] - slope[k - 1])
    needed = np.minimum(needed, edge)
    lift = np.maximum(needed - (toe[:, 1] - sole), 0.0)
    lift[stands] = 0.0
    return lift[:, None]


def _ease(share: Array) -> Array:
    """Return a smooth step of shares, shape (T, 1, 1)."""
    return smooth_step(share)[:, None, None]


def _median(values: Array, weights: Array) -> float:
    """Return the weighted median, between two values where both are in the middle."""
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order] + 1e-3)
    half, rounding = 0.5 * sums[-1], 1e-9 * sums[-1]
    middle = np.searchsorted(sums, [half - rounding, half + rounding])
    return float(values[order][middle].mean())
