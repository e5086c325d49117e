"""When each foot stands on the floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.retarget.runs import runs

from .smooth import smooth

SIDES = ("Left", "Right")
"""Order of the feet."""

_CUTOFF = 3.0  # Hz: a stance lasts longer than Kinect's noise in the feet
_LEAST_WEIGHT = 0.1  # of an invented ankle in the smoother, against a measured one's 1
# Log odds of standing, by logistic regression on simulated takes (51 motions, of people
# and seeds of their own). On six recorded people the area under ROC is 0.99.
_STANDS = 4.0
_PER_SPEED = 5.0  # per m/s of the ankle. Upwards too: who jumps lifts both at once.
_PER_LIFT = 15.0  # per m that the ankle is higher than the other
_PER_HEIGHT = (
    12.0  # per m that both are higher than Kinect's errors in squats lift them
)
_LOWER, _HIGHER = -0.1, 0.3  # m: where more says no more
_ERROR_OF_HEIGHT = 0.1  # m
_STANDING = 20.0  # percentile of the ankles' heights that is taken for standing
_SWITCH = 4.0  # what a change costs, in the same unit: the hysteresis. A guess.
_SPEED_TIME = 0.1  # s that a speed is a mean over where nobody looks ahead
_RATE = 30.0  # Hz of the takes it is for: more frames a second say no more
_DRIFT = 0.10  # m: an ankle that moved farther has made a step that nobody saw
_UNLOADING = 0.15  # s: from the first rise of a foot to its leaving
_STEP = 0.3  # s: how long such a step takes


def ankles_and_toes(skeleton: Skeleton) -> tuple[list[int], list[int]]:
    """Return the indices of the ankles and of the feet, in the order of SIDES."""
    ankles, toes = (
        [skeleton.index(part + side) for side in SIDES] for part in ("Ankle", "Foot")
    )
    return ankles, toes


def find_stance(
    time: Array, positions: Array, trust: Array, skeleton: Skeleton
) -> NDArray[np.bool_]:
    """Return whether each foot stands in each frame, shape (T, 2), order of SIDES.

    A foot stands while its ankle rests and is no higher than the other's. The most
    probable sequence of standing and stepping is taken, where every change costs
    something: Viterbi's algorithm, which is a hysteresis that looks ahead.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], y up, shape (T, J, 3).
        trust: Share of the measurement in each joint, shape (T, J).
        skeleton: The joints.
    """
    ankles, _ = ankles_and_toes(skeleton)
    weights = np.maximum(trust[:, ankles], _LEAST_WEIGHT)
    paths = smooth(time, positions[:, ankles], weights, cutoff=_CUTOFF)
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0 / _RATE
    stands = _most_probable(_RATE * step * _log_odds(time, paths))
    for foot in range(2):
        for stance in runs(stands[:, foot]):
            _split(time, paths[:, foot][:, [0, 2]], stands[:, foot], stance)
    return _unloaded(time, stands)


def feet_of(contacts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether each foot stands, (T, 2), from its parts (CONTACTS), (T, 4)."""
    return np.asarray(contacts.reshape(-1, 2, 2).any(axis=2))


def _log_odds(time: Array, paths: Array) -> Array:
    """Return the log odds of standing from the ankles' paths, shape (T, 2)."""
    speed = np.zeros(paths.shape[:2])
    if len(time) > 1:
        velocity = np.gradient(paths, time, axis=0)
        speed = np.linalg.norm(velocity, axis=2)
    height = paths[..., 1]
    above = height - np.percentile(height, _STANDING) - _ERROR_OF_HEIGHT
    return _odds(speed, height, above)


def _odds(speed: Array, height: Array, above: Array) -> Array:
    lift = np.clip(height - height[..., ::-1], _LOWER, _HIGHER)
    above = np.clip(above, 0.0, _HIGHER)
    speed = np.minimum(speed, 1.0)
    return np.asarray(
        _STANDS - _PER_SPEED * speed - _PER_LIFT * lift - _PER_HEIGHT * above
    )


def _most_probable(log_odds: Array) -> NDArray[np.bool_]:
    """Return the sequence of two states with the highest sum, changes charged."""
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
        """Whether each foot stands, order of SIDES, shape (2,)."""

    def step(self, ankles: Array, flat: float, dt: float) -> NDArray[np.bool_]:
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


def _unloaded(time: Array, stands: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return stances without the time to lift the foot and to set it down."""
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


def _split(time: Array, path: Array, stands: NDArray[np.bool_], stance: slice) -> None:
    """Part a stance (in place) whose foot is elsewhere at its end."""
    points = path[stance]
    count = len(points)
    if count < 4:
        return
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    if away.max() < _DRIFT:
        return
    # Where two resting places fit best.
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
