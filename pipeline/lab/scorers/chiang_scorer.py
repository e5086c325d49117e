"""Reliability after Chiang 2017, section 4.2.

It combines Shum's segment lengths with a test for errors that last a single frame.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np

from kinefilter.characters import Skeleton, State
from kinefilter.characters.arrays import Array, Codes
from kinefilter.pipeline.reliability import Reference, ReliabilityScorer


@dataclass(eq=False, repr=False)
class ChiangReliabilityScorer(ReliabilityScorer):
    """Scores frame by frame; a whole take gets the same scores.

    An inferred joint is as reliable as its segments and its motion are plausible; only
    a joint that is not tracked scores 0 for its state. Term.BEHAVIOR stands for the
    temporal term, whose threshold is per frame, at 30 Hz.
    """

    skeleton: Skeleton
    reference: Reference  # the person's segment lengths
    _: KW_ONLY
    largest_displacement: float = 0.03  # T [m]: of joints not in error (eq. 10)
    steepness: float = 4.0  # reliability lost per T beyond T (eq. 10)
    now: float = 0.7  # weight of the current frame, not the one before (eq. 12)

    def __post_init__(self) -> None:
        super().__init__(self.skeleton, self.reference)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._past: list[Array] = []
        self._previous: Array | None = None

    def step(
        self,
        positions: Array,
        state: Codes,
        time: float | None = None,  # noqa: ARG002 - the terms are for 30 Hz
    ) -> tuple[Array, Codes, Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        temporal = self._temporal(positions)
        kinematics = self._kinematics(positions)  # eq. 6-7
        tracking = np.where(state == State.NOT_TRACKED, 0.0, 1.0)  # eq. 11
        terms = np.stack([temporal, kinematics, tracking])
        term = np.argmin(terms, axis=0).astype(np.uint8)
        scores = np.stack([terms.min(axis=0), np.minimum(temporal, kinematics)])
        before = scores if self._previous is None else self._previous
        self._previous = scores
        mean = self.now * scores + (1.0 - self.now) * before  # eq. 12
        return mean[0], term, mean[1]

    def _temporal(self, positions: Array) -> Array:
        """Return the term for jumps away from both previous frames (eq. 8-10).

        Eq. 10 prints (1 - 4 (d2 - T)) / T, which exceeds 1; here it is 1 - 4 (d2 - T) /
        T, at least 0; 1 where a position is missing, and in the first two frames.
        """
        term = np.ones(len(positions))
        if len(self._past) == 2:
            d1, d2 = np.sqrt(np.sum((positions - np.array(self._past)) ** 2, axis=2))
            largest = self.largest_displacement
            moved = (d1 > largest) & (d2 > largest)
            excess = (d2[moved] - largest) / max(largest, 1e-9)
            term[moved] = np.maximum(1.0 - self.steepness * excess, 0.0)
        self._past = [*self._past[-1:], positions.copy()]
        return term
