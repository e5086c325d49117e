"""Fuses what several sensors see of a person at a moment into one skeleton.

Each joint is the weighted mean of the sensors' positions. Each sensor is weighted by
the joint's reliability; the weight falls as the sensor's view turns from frontal to
side-on, most of all for the limbs behind the body. Each sensor's own constant
misplacement of a joint is learned on the way and subtracted. Errors along the line of
sight are no larger than across it, both on UI-PRMD's people and in the virtual Kinect.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Skeleton, State
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.rotations import wrapped
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.failures.sides import CheapestPath, Sides
from kinefilter.retarget import HeadingFrame, find_yaw

# Chosen on simulated people (seeds 40 to 55 and 140 to 153) and on p00 to p08 of
# two-kinects; results hardly depend on any but the first two.
_BESIDE = 2.0  # exponent by which the weight falls at right angles to the person
_BEHIND = 2.0  # exponent by which it falls further for a limb behind the body
_INFERRED = 0.3  # maximum reliability of an inferred joint
_MIN_RELIABILITY = 1e-3  # of a reported joint
_BLEND = 0.08  # s, time constant of the weights
_LEARNING = 30.0  # s over which misplacements are averaged
_MAX_OFFSET = 0.15  # m of a misplacement
_COUNTS = 0.2  # share above which a sensor's state counts for the joint
# Chosen on seeds 40 to 51 and 140 to 145, and on the same sessions:
_TOLERANCE = np.radians(45.0)  # rad by which a heading may be off
_MAX_COST = 4.0  # in squared tolerances, of one sensor
_TURNING = np.radians(100.0)  # rad/s at which turning costs as much as the tolerance
_GRID = 2.0 * np.pi * np.arange(72) / 72  # headings to choose from [rad]
_TURNS = wrapped(_GRID[:, None] - _GRID)  # from each to each [rad]


class Sight(NamedTuple):
    """What a sensor sees of a person at a moment."""

    positions: Array  # joints [m] in the merged frame, NaN where missing, (J, 3)
    reliability: Array  # of each joint, in [0, 1], (J,)
    state: Codes  # tracking states (State), (J,)
    sensor: Array  # position of the sensor [m], (3,)


class Fused(NamedTuple):
    """A person as all sensors see them together."""

    positions: Array  # joints [m], NaN where no sensor has any, (J, 3)
    state: Codes  # the best state among the sensors that count, (J,)
    reliability: Array  # mean over the sensors that count, in [0, 1], (J,)
    shares: Array  # of each sensor in each joint, adding up to 1 or 0, (S, J)
    swapped: Flags  # which sensors had left and right swapped, (S,)


class Facing(CheapestPath):
    """Follows the heading [rad], 0 along +z, of a person whom several sensors see.

    A sensor sees people who face it, or face away, as they are, but shows people at its
    side turned toward itself. So each is weighted by the squared cosine of the angle
    from which it would look at them; where sensors contradict each other, people turn
    no faster than they have to: the heading is the cheapest path over all frames
    (Viterbi 1967), or, live, the cheapest path so far.
    """

    def __init__(self) -> None:
        super().__init__(_GRID)

    def _costs(
        self, yaws: Array, angles: Array, elapsed: Array
    ) -> Iterable[tuple[Array, Array]]:
        """Yield what headings cost in frames; see ``CheapestPath``.

        ``yaws`` are the headings in each sensor [rad], without swapped sides, NaN where
        it sees no one, and ``angles`` the directions to each sensor [rad], both (T, S);
        ``elapsed`` is the time since the last frame [s], (T,).
        """
        errors = wrapped(yaws[..., None] - _GRID) / _TOLERANCE
        views = np.cos(angles[..., None] - _GRID) ** 2
        costs = np.nansum(views * np.minimum(errors**2, _MAX_COST), axis=1)
        spans = _TURNING * np.maximum(elapsed, 1e-3)
        turning = ((_TURNS / span) ** 2 for span in spans)
        return zip(turning, costs, strict=True)


class Fusion:
    """Fuses the frames of some sensors, one after the other."""

    def __init__(self, skeleton: Skeleton, sensors: int) -> None:
        self._skeleton = skeleton
        self._sides, self._facing = Sides(skeleton, sensors), Facing()
        left, right = SIDES
        side = [name.endswith(left) - name.endswith(right) for name in skeleton.joints]
        self._side = np.array(side, dtype=float)  # 1 on the left, -1 on the right
        count, origin = len(skeleton), np.full(3, np.nan)
        state = np.zeros(count, dtype=np.uint8)
        missing = np.full((count, 3), np.nan)
        self._nothing = Sight(missing, np.zeros(count), state, origin)
        self._learned = np.zeros((sensors, count))  # s from which offsets were learned
        self._offsets = np.zeros((sensors, count, 3))
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion, but keep the learned misplacements."""
        self._weights = np.zeros_like(self._learned)
        self._sides.start()
        self._facing.start()

    def precompute(
        self, frames: Sequence[Sequence[Sight | None]], elapsed: Array
    ) -> tuple[Flags, Array]:
        """Precompute what needs the whole take: arguments of ``step`` for each frame.

        Which sensors have left and right swapped, (T, S), and which way the person
        faces [rad], (T,), 0 along +z. ``elapsed`` is the time since the last frame [s].
        """
        each = [self._stack(sights) for sights in frames]
        seen = Sight(*map(np.array, zip(*each, strict=True)))
        swapped = self._sides.whole(seen.positions, _weights(seen))
        self._swap(seen, swapped)
        return swapped, self._facing.whole(*self._directions(seen), elapsed)

    def _stack(self, sights: Sequence[Sight | None]) -> Sight:
        """Return what all sensors see, arrays with a leading axis S."""
        each = (self._nothing if sight is None else sight for sight in sights)
        return Sight(*map(np.array, zip(*each, strict=True)))

    def _swap(self, seen: Sight, swapped: Flags) -> None:
        for part in seen[:3]:
            part[swapped] = part[swapped][:, self._skeleton.mirror]

    def _directions(self, seen: Sight) -> tuple[Array, Array]:
        """Return headings that sensors see, and directions to them [rad], (..., S)."""
        away = seen.sensor - seen.positions[..., self._skeleton.root, :]
        yaws = find_yaw(seen.positions, self._skeleton, seen.reliability)
        return yaws, np.arctan2(away[..., 0], away[..., 2])

    def step(
        self,
        sights: Sequence[Sight | None],
        elapsed: float,
        swapped: Flags | None = None,
        heading: float | None = None,
    ) -> Fused:
        """Fuse the next frame, ``elapsed`` [s] after the last.

        ``sights`` has None for sensors that see no one. Which sensors have left and
        right swapped, (S,), and the person's heading [rad] are by default found from
        the frames so far.
        """
        stacked = self._stack(sights)
        if swapped is None:
            swapped = self._sides.step(stacked.positions, _weights(stacked))
        self._swap(stacked, swapped)
        yaws, angles = self._directions(stacked)
        if heading is None:
            heading = self._facing.step(yaws, angles, elapsed)
        seen, given, state, _ = stacked
        missing = np.isnan(seen[..., 0])
        most = np.where(state == State.INFERRED, _INFERRED, 1.0)
        reliability = np.where(missing, 0.0, np.clip(given, _MIN_RELIABILITY, most))
        seen = np.where(missing[..., None], 0.0, seen)
        across = np.sin(np.nan_to_num(angles - heading))[:, None]
        doubt = _BESIDE * np.abs(across) + _BEHIND * np.maximum(-across * self._side, 0)
        frame = HeadingFrame(np.zeros(3), np.array(heading))
        placed = seen - frame.restore(self._offsets)
        weights = reliability * np.exp(-doubt)
        share = 1.0 - np.exp(-elapsed / _BLEND)
        blended = self._weights + share * (weights - self._weights)
        both = (self._weights > 0.0) & (weights > 0.0)
        self._weights = weights = np.where(both, blended, weights)
        total = weights.sum(axis=0)
        shares = weights / np.where(total > 0.0, total, 1.0)
        fused = np.einsum("sj,sji->ji", shares, placed)
        self._learn(frame.remove(seen - fused), reliability > _INFERRED, elapsed)
        fused[total == 0.0] = np.nan
        best = np.where(shares > _COUNTS, state, 0).max(axis=0).astype(np.uint8)
        return Fused(fused, best, (shares * given).sum(axis=0), shares, swapped)

    def _learn(self, away: Array, trusted: Flags, elapsed: float) -> None:
        """Average how far joints are from the fused ones [m], in the heading frame."""
        seconds = np.where(trusted & (trusted.sum(axis=0) > 1), elapsed, 0.0)
        size = np.linalg.norm(away, axis=2)
        away = away * np.minimum(1.0, _MAX_OFFSET / np.maximum(size, 1e-9))[..., None]
        self._learned += seconds
        share = seconds / np.clip(self._learned, 1e-9, _LEARNING)
        self._offsets += share[..., None] * (away - self._offsets)


def _weights(seen: Sight) -> Array:
    """Return how much each joint counts in finding the sides, (..., S, J)."""
    tracked = np.where(seen.state == State.TRACKED, seen.reliability, 0.0)
    return tracked + _MIN_RELIABILITY
