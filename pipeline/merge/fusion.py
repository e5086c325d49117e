"""One skeleton of what several sensors see of a person at a moment.

Each joint is the weighted mean of where the sensors put it. A sensor counts by the
reliability of the joint, by how far it sees the person from in front, and by whether
the limb is on its side of the body. Where sensors disagree, the better one counts all
the more: between two places of an arm there is none. Each sensor's own constant
misplacement of a joint is learned on the way and taken off. Errors along the line of
sight are no larger than across it, on UI-PRMD's people as in the virtual Kinect.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton, State
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import HeadingFrame, find_yaw

# Chosen on simulated people (seeds 40 to 55 and 140 to 153) and on p00 to p08 of
# two-kinects; hardly anything depends on them but the last two of the exchange.
_FAR = 3.0  # by which the variance of a limb behind the body grows, from the side
_TURNED = 1.0  # and that of all joints per 90 degrees away from the front
_INFERRED = 0.3  # reliability at most of what a sensor only guesses
_LEAST = 1e-3  # reliability of what a sensor gives at all
_APART = 0.10  # m between sensors, from which the better one counts twice as clearly
_BLEND = 0.15  # s in which weights follow
_LEARNING = 30.0  # s in which misplacements are learned
_LARGEST = 0.15  # m of a misplacement
_COUNTS = 0.2  # share from which on a sensor's state is that of the joint
_LOST = 0.5  # m: joints farther apart tell nothing more of exchanged sides
_CHANGE = 0.02  # m of mean distance that it takes to exchange sides, or to end it
_GOES_ON = 0.25  # weight of the frame before; of sensors among each other 1
_EXCHANGED = 0.05  # m that sides have to agree better by for as long as exchanged


class Sight(NamedTuple):
    """What a sensor sees of a person at a moment."""

    positions: Array
    """Joints [m] in the merged frame, NaN where missing, (J, 3)."""
    reliability: Array
    """Of each joint, in [0, 1], (J,)."""
    state: NDArray[np.uint8]
    """Tracking states (State), (J,)."""
    sensor: Array
    """Where the sensor is [m], (3,)."""


class Fused(NamedTuple):
    """A person as all sensors see them together."""

    positions: Array
    """Joints [m], NaN where no sensor has any, (J, 3)."""
    state: NDArray[np.uint8]
    """The best state among the sensors that count, (J,)."""
    reliability: Array
    """Mean reliability of the sensors that count, in [0, 1], (J,)."""
    shares: Array
    """How much of each joint is of which sensor, adding up to 1 or 0, (S, J)."""
    exchanged: Flags
    """Which sensors had left and right exchanged, (S,)."""


class Fusion:
    """Merges one frame after the other.

    Args:
        skeleton: The joints.
        sensors: How many sensors there are.
    """

    def __init__(self, skeleton: Skeleton, sensors: int) -> None:
        self._skeleton, self._mirror = skeleton, np.array(skeleton.mirror)
        left, right = (
            np.array([joint.endswith(side) for joint in skeleton.joints])
            for side in SIDES
        )
        self._side = left.astype(float) - right
        self._pairs = np.flatnonzero(self._side)
        self._choices = np.array(list(product((0, 1), repeat=sensors)))
        self._shape = (sensors, len(skeleton))
        self._offsets = np.zeros((*self._shape, 3))
        self._known = np.zeros(self._shape)
        self.start()

    def start(self) -> None:
        """Forget all frames, but not where sensors misplace joints."""
        self._weights, self._yaw = np.zeros(self._shape), 0.0
        self._last: Array | None = None
        self._exchanged = np.zeros(self._shape[0], dtype=np.intp)

    def step(self, sights: Sequence[Sight | None], elapsed: float) -> Fused:
        """Merge the next frame.

        Args:
            sights: What each sensor sees, None where it sees nobody.
            elapsed: Time since the last frame [s].
        """
        seen = np.full((*self._shape, 3), np.nan)
        given, state = np.zeros(self._shape), np.zeros(self._shape, dtype=np.uint8)
        angle = np.full(self._shape[0], np.nan)
        for s, sight in enumerate(sights):
            if sight is not None:
                seen[s], given[s], state[s] = sight[:3]
                there = sight.sensor - seen[s, self._skeleton.root]
                angle[s] = np.arctan2(there[0], there[2])
        self._untangle(seen, given, state, angle)
        missing = np.isnan(seen[..., 0])
        most = np.where(state == State.INFERRED, _INFERRED, 1.0)
        reliability = np.where(missing, 0.0, np.clip(given, _LEAST, most))
        seen = np.where(missing[..., None], 0.0, seen)
        view = np.nan_to_num(angle - self._yaw)[:, None]
        far = np.maximum(-np.sin(view) * self._side, 0.0)
        variance = 1.0 + _FAR * far + _TURNED * (1.0 - np.cos(view))
        placed = seen - self._heading.restore(self._offsets)
        weights = _contrasted(placed, reliability / variance)
        share = 1.0 - np.exp(-elapsed / _BLEND)
        both = (self._weights > 0.0) & (weights > 0.0)
        weights = np.where(
            both, self._weights + share * (weights - self._weights), weights
        )
        self._weights = weights
        whole = weights.sum(axis=0)
        shares = np.divide(
            weights, whole, out=np.zeros_like(weights), where=whole > 0.0
        )
        fused = np.einsum("sj,sji->ji", shares, placed)
        self._learn(seen - fused, reliability, elapsed)
        fused[whole == 0.0] = np.nan
        self._last = fused
        best = np.where(shares > _COUNTS, state, 0).max(axis=0).astype(np.uint8)
        return Fused(
            fused, best, (shares * given).sum(axis=0), shares, self._exchanged > 0
        )

    def _untangle(
        self, seen: Array, given: Array, state: NDArray[np.uint8], angle: Array
    ) -> None:
        """Exchange left and right of sensors that have them the wrong way round.

        A sensor takes people whom it sees from behind for people who face it. The sides
        are those on which the sensors agree best with each other and with the frame
        before.
        """
        pairs = self._pairs
        both = np.stack([seen[:, pairs], seen[:, self._mirror[pairs]]], axis=1)
        others = [*both] if self._last is None else [*both, self._last[None, pairs]]
        sure = np.where(state == State.TRACKED, given, 0.0) + _LEAST
        sure = np.minimum(sure, sure[:, self._mirror])[:, pairs]
        sure = np.vstack([sure, np.ones(len(pairs))])
        costs = np.zeros(len(self._choices))
        for s, one in enumerate(both):
            for k, other in enumerate(others[s + 1 :], start=s + 1):
                apart = np.linalg.norm(one[:, None] - other[None], axis=3)
                apart = np.minimum(apart, _LOST)
                known = ~np.isnan(apart).any(axis=(0, 1))
                if known.any():
                    both_sure = (sure[s] * sure[k])[known]
                    cost = np.average(apart[..., known], axis=-1, weights=both_sure)
                    if k < len(both):
                        costs += cost[self._choices[:, s], self._choices[:, k]]
                    else:
                        costs += _GOES_ON * cost[self._choices[:, s], 0]
        costs += _CHANGE * (self._choices != self._exchanged).sum(axis=1)
        costs += _EXCHANGED * self._choices.sum(axis=1)
        self._exchanged = self._choices[int(np.argmin(costs))]
        for s in np.flatnonzero(self._exchanged).tolist():
            seen[s], given[s] = seen[s, self._mirror], given[s, self._mirror]
            state[s] = state[s, self._mirror]
        yaw = find_yaw(seen, given, self._skeleton)
        known = ~np.isnan(yaw + angle)
        if known.any():
            # The line through the shoulders is seen best from in front and behind.
            straight = np.cos(angle[known] - yaw[known]) ** 2
            self._yaw = _mean_angle(yaw[known], 0.1 + straight)

    @property
    def _heading(self) -> HeadingFrame:
        return HeadingFrame(np.zeros(3), np.array(self._yaw))

    def _learn(self, away: Array, reliability: Array, elapsed: float) -> None:
        """Learn where sensors misplace joints that several of them see."""
        several = (reliability > _INFERRED).sum(axis=0) > 1
        use = several & (reliability > _INFERRED)
        size = np.linalg.norm(away, axis=2)
        away = away * np.minimum(1.0, _LARGEST / np.maximum(size, 1e-9))[..., None]
        self._known += np.where(use, elapsed, 0.0)
        share = np.where(use, elapsed, 0.0) / np.clip(self._known, 1e-9, _LEARNING)
        toward = self._heading.remove(away) - self._offsets
        self._offsets += share[..., None] * toward


def _contrasted(placed: Array, trust: Array) -> Array:
    """Return weights, the more different the farther the sensors are apart, (S, J)."""
    whole = np.maximum(trust.sum(axis=0), 1e-12)
    middle = np.einsum("sj,sji->ji", trust, placed) / whole[:, None]
    squared = np.sum((placed - middle) ** 2, axis=2)
    spread = np.sqrt((trust * squared).sum(axis=0) / whole)
    best = np.maximum(trust.max(axis=0), 1e-12)
    return np.asarray(best * (trust / best) ** (1.0 + np.minimum(spread / _APART, 4.0)))


def _mean_angle(angles: Array, weights: Array) -> float:
    return float(np.angle(np.sum(weights * np.exp(1j * angles))))
