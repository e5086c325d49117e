"""Which sensors have a person's left and right exchanged.

A sensor takes people whom it sees from behind for people who face it. Where the limbs
are it still sees, and limbs tell which way a body faces: knees bend forward, elbows
backward, hands and head are in front. So the sides are those on which the sensors agree
with each other and with the way the body bends, without joints that leap from one side
to the other: the cheapest path over all frames (Viterbi 1967). Live, it is the cheapest
path so far.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

# Chosen on simulated people (seeds 40 to 51 and 140 to 145) and on p00 to p08 of
# two-kinects.
_LOST = 0.5  # m: joints farther apart tell nothing more
_BEND = 0.15  # m by which limbs are in front of the body where it surely faces there
_FACING = 0.1  # m of mean distance that such a body weighs
_EXCHANGED = 0.02  # m that sides have to agree better by for as long as exchanged
_CHANGE = 0.02  # m more that a change costs than the way the joints take
_GOES_ON = 5.0  # weight of the way that joints take from frame to frame


class CheapestPath:
    """Follows which of some choices (N, ...) hold, frame by frame (Viterbi 1967)."""

    def __init__(self, choices: NDArray[Any]) -> None:
        self._choices = choices
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._costs = np.zeros(len(self._choices))

    def step(self, *seen: Any) -> tuple[Any, NDArray[np.uint16]]:
        """Return the best choice so far, and what ``whole`` needs to look back."""
        raise NotImplementedError

    def _next(self, ways: Array, costs: Array) -> tuple[Any, NDArray[np.uint16]]:
        """Return the best choice, and the one before on the cheapest way to each.

        Choices of this frame cost (N,), and ways to them from those before (N, N).
        """
        ways = self._costs[:, None] + ways
        costs = costs + ways.min(axis=0)
        self._costs = costs - costs.min()
        return self._choices[costs.argmin()], ways.argmin(axis=0).astype(np.uint16)

    def whole(self, frames: Iterable[tuple[Any, ...]]) -> NDArray[Any]:
        """Return the choice in each frame, (T, ...), of what ``step`` takes of it."""
        self.start()
        came = [self.step(*frame)[1] for frame in frames]
        path = [int(self._costs.argmin())]
        for before in came[:0:-1]:
            path.append(int(before[path[-1]]))
        return self._choices[path[::-1]]


class Sides(CheapestPath):
    """Follows which of so many sensors have left and right exchanged, flags (S,)."""

    def __init__(self, skeleton: Skeleton, sensors: int) -> None:
        self._skeleton, self._mirror = skeleton, skeleton.mirror
        self._pairs = np.flatnonzero(self._mirror != np.arange(len(skeleton)))
        choices = np.array(list(product((False, True), repeat=sensors)))
        self._changes = choices[:, None] != choices
        super().__init__(choices)

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._last: list[tuple[Array, Array] | None] = [None] * self._choices.shape[1]

    def step(self, seen: Array, sure: Array) -> tuple[Any, NDArray[np.uint16]]:
        """Return which sensors have sides exchanged, by the frames so far.

        Args:
            seen: Where each sensor has the joints [m], NaN where nowhere, (S, J, 3).
            sure: How much each joint counts, (S, J).
        """
        sure = np.minimum(sure, sure[:, self._mirror])[:, self._pairs]
        as_given, mirrored = seen[:, self._pairs], seen[:, self._mirror[self._pairs]]
        faces = np.tanh(self._forward(seen) / _BEND)
        costs = self._choices @ (_EXCHANGED + _FACING * np.nan_to_num(faces))
        ways = np.zeros(self._changes.shape[:2])
        for s, last in enumerate(self._last):
            if last is not None:
                same, other = (
                    _distance(now, last[0], sure[s] * last[1])
                    for now in (as_given[s], mirrored[s])
                )
                ways += _GOES_ON * np.where(
                    self._changes[..., s], other + _CHANGE, same
                )
            if not np.isnan(as_given[s]).all():
                self._last[s] = as_given[s], sure[s]
        for s, k in combinations(range(len(seen)), 2):
            weights = sure[s] * sure[k]
            same, other = (
                _distance(as_given[s], there[k], weights)
                for there in (as_given, mirrored)
            )
            costs += np.where(self._choices[:, s] == self._choices[:, k], same, other)
        return self._next(ways, costs)

    def _forward(self, seen: Array) -> Array:
        """Return how far limbs bend to where bodies face by their sides [m], (S,).

        Of frames in which people who walk face where they go, or away from it, this
        tells 98 and 76 % right (p10 to p18 of two-kinects).
        """

        def middle(*names: str) -> Array:
            joints = [joint for name in names for joint in self._skeleton.sides(name)]
            return np.asarray(seen[:, joints].mean(axis=1))

        skeleton = self._skeleton
        left, right = (
            seen[:, [skeleton.sides(name)[k] for name in ("Hip", "Shoulder")]].mean(1)
            for k in (0, 1)
        )
        across = (left - right)[:, [0, 2]]
        across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-9
        bends = middle("Knee") - middle("Hip", "Ankle")
        bends -= middle("Elbow") - middle("Shoulder", "Wrist")
        bends += 0.5 * (middle("Wrist") - middle("Shoulder"))
        head = seen[:, skeleton.index("Head")] - seen[:, skeleton.girdle]
        bends += 0.5 * head
        return np.asarray(bends[:, 2] * across[:, 0] - bends[:, 0] * across[:, 1])


def _distance(points: Array, others: Array, weights: Array) -> float:
    """Return the mean distance between joints that both have [m], 0 without any."""
    apart = np.minimum(np.linalg.norm(points - others, axis=1), _LOST)
    known = ~np.isnan(apart)
    return (
        float(np.average(apart[known], weights=weights[known])) if known.any() else 0.0
    )
