"""How far each joint of each frame can be trusted, by Chiang 2017, section 4.2.

Beside Shum's segment lengths it has a test for errors of a single frame, and it leaves
open what a sensor infers instead of refusing it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import State
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability import ReliabilityScorer

LARGEST_DISPLACEMENT = 0.03
"""T [m]: a joint that is no farther from where it was has made no error (eq. 10)."""
STEEPNESS = 4.0
"""Trust lost per T of displacement beyond T (eq. 10): none is left at 1.25 T."""
NOW, BEFORE = 0.7, 0.3
"""Weights of the frame itself and of the frame before (eq. 12)."""


class ChiangReliabilityScorer(ReliabilityScorer):
    """Scores one frame after the other; a whole take goes the same way.

    An inferred joint's tracking state is unknown: it takes no part in the minimum of
    the terms, so the joint is worth what its segments and its movement are. Only a
    joint that is not tracked scores 0 by its state. The deciding term is Term.BEHAVIOR
    where the temporal term, which takes that place, is the smallest.

    The threshold of the movement is per frame and made for 30 Hz.

    Args:
        skeleton: The joints.
        reference: The person's segment lengths.
    """

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past: list[Array] = []
        self._previous: Array | None = None

    def step(
        self,
        positions: Array,
        state: NDArray[np.uint8],
        time: float | None = None,  # noqa: ARG002 - made for 30 Hz
    ) -> tuple[Array, NDArray[np.uint8], Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        temporal = self._temporal(positions)
        kinematics = self._kinematics(positions)  # eq. 6-7
        # Eq. 11; 1, the neutral element of the minimum, for what is unknown.
        tracking = np.where(state == State.NOT_TRACKED, 0.0, 1.0)
        terms = np.stack([temporal, kinematics, tracking])
        term = np.argmin(terms, axis=0).astype(np.uint8)
        scores = np.stack([terms.min(axis=0), np.minimum(temporal, kinematics)])
        before = scores if self._previous is None else self._previous
        self._previous = scores
        rate, geometry = NOW * scores + BEFORE * before  # eq. 12
        return rate, term, geometry

    def _temporal(self, positions: Array) -> Array:
        """Return the term for jumps that stay: large to both frames before (eq. 8-10).

        Eq. 10 prints (1 - 4 (d2 - T)) / T, which exceeds 1. Where a position is missing
        or there are no two frames yet, there is no displacement and full trust.
        """
        trust = np.ones(len(positions))
        if len(self._past) == 2:
            oldest, last = self._past
            d1, d2 = _distance(positions, oldest), _distance(positions, last)
            moved = (d1 > LARGEST_DISPLACEMENT) & (d2 > LARGEST_DISPLACEMENT)
            excess = (d2[moved] - LARGEST_DISPLACEMENT) / LARGEST_DISPLACEMENT
            trust[moved] = np.maximum(1.0 - STEEPNESS * excess, 0.0)
        self._past = [*self._past[-1:], positions.copy()]
        return trust


def _distance(a: Array, b: Array) -> Array:
    """Return the distance [m] of each joint's two positions, shape (J,)."""
    return np.asarray(np.sqrt(np.sum((a - b) ** 2, axis=1)))
