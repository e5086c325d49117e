"""How a prior posture and a measured one are blended, and how gaps are filled.

``Hold`` corrects nothing: measured joints stay, missing ones keep their last bones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.linalg.lapack import dposv

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import between, rotate

from .interface import Correction, Corrector, Observation, measured_only

UNRELIABLE, RELIABLE = 0.3, 0.95
"""Below the first reliability a measurement is ignored; from the second on it is taken
as it is. With 0.6 and 0.85 less of the error of simulated takes goes away; those, and
0.4 and 0.95, do more harm to recorded people. Chiang's 0.7 in the place of both misses
most of what helps."""

_FIRMEST = 1e3  # weight of a fully trusted joint against one bone's pull


def measurement_confidence(
    reliability: Array, geometry: Array, missing: Flags, coverage: float
) -> Array:
    """Return how far each joint follows its measurement, in [0, 1], shape (J,).

    Reliable joints stay where they are. What is unreliable follows the prior as far as
    the prior knows the posture; where it does not, it leans on the measurement as far
    as the positions by themselves look sound.

    Args:
        reliability: Reliability, shape (J,).
        geometry: The reliability without the tracking state, shape (J,).
        missing: Nothing was measured, shape (J,).
        coverage: How well the prior knows the posture, in [0, 1].
    """
    span = RELIABLE - UNRELIABLE
    confidence = np.clip((reliability - UNRELIABLE) / span, 0.0, 1.0)
    sound = np.clip((geometry - UNRELIABLE) / span, 0.0, 1.0)
    confidence = confidence + (1.0 - confidence) * (1.0 - coverage) * sound
    return np.where(missing, 0.0, confidence)


class Blend:
    """Moves a prior posture onto the trusted part of a measured one.

    The residual (measured minus prior) of trusted joints spreads over the skeleton to
    the others: it minimizes sum of w_j |r_j - residual_j|^2 + sum over bones of
    |r_j - r_parent|^2 with w = c / (1 - c) and the confidence c. Trusted joints end
    where they were measured, the others keep the prior's bones as far as their
    neighbors allow, and the result is continuous in the confidence.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        n = len(skeleton)
        self._laplacian = np.zeros((n, n))
        for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
            self._laplacian[[j, p], [j, p]] += 1.0
            self._laplacian[[j, p], [p, j]] -= 1.0

    def __call__(self, prior: Array, measured: Array, confidence: Array) -> Array:
        """Return the blended posture [m], shape (J, 3).

        Args:
            prior: Joint positions [m], finite, shape (J, 3).
            measured: Joint positions [m], NaN only where the confidence is 0, (J, 3).
            confidence: Share of the measurement, in [0, 1], shape (J,).
        """
        if confidence.min() >= 1.0:
            return measured.copy()
        residual = np.where(confidence[:, None] > 0.0, measured - prior, 0.0)
        weights = confidence / np.maximum(1.0 - confidence, 1.0 / _FIRMEST)
        matrix = self._laplacian.copy()
        matrix.flat[:: len(confidence) + 1] += weights + 1e-6
        # LAPACK itself: the wrapper takes longer than so small a solution.
        spread = dposv(matrix, weights[:, None] * residual)[1]
        blended = prior + spread
        # Joints with confidence 1 stay exactly where they were measured.
        return np.where(confidence[:, None] >= 1.0, measured, blended)


class Hold(Corrector):
    """Passes measurements through and hangs missing joints on their last bones.

    Until they are seen, hands and feet go on as at rest from the bone before.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._blend = Blend(skeleton)
        rest = standard_body(skeleton).rest_positions
        self._rest = rest - rest[skeleton.root]
        self._parents, limbs = skeleton.parents, ("Wrist", "Ankle")
        ends = {joint for limb in limbs for joint in skeleton.sides(limb)}
        self._ends: list[int] = []  # what is beyond them, parents first
        for j in skeleton.order:
            if skeleton.parents[j] in ends:
                ends.add(j)
                self._ends.append(j)
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._last = self._rest
        self._met = np.zeros(len(self._rest), dtype=np.bool_)

    def _hang(self, postures: Array, met: Flags) -> None:
        """Put hands and feet that nobody has met yet in their places.

        Postures [m] are (T, J, 3); ``met`` (T, J): the joint was seen by that frame.
        """
        for j in self._ends:
            unmet = postures[~met[:, j]]
            if len(unmet):
                p = self._parents[j]
                above = self._parents[p]
                turn = between(
                    self._rest[p] - self._rest[above], unmet[:, p] - unmet[:, above]
                )
                own = rotate(turn, self._rest[j] - self._rest[p])
                postures[~met[:, j], j] = unmet[:, p] + own

    def fill(self, positions: Array) -> Array:
        """Return the next frames filled as ``step`` does it, all at once, (T, J, 3).

        Args:
            positions: Joint positions [m], NaN where missing, shape (T, J, 3).
        """
        filled = positions.copy()
        missing = np.isnan(positions[..., 0])
        for k in np.flatnonzero(missing.any(axis=1)):
            last = filled[k - 1] if k else self._last
            filled[k] = self._blend(last, positions[k], np.where(missing[k], 0.0, 1.0))
        met = np.logical_or.accumulate(np.vstack([self._met, ~missing]))[1:]
        self._hang(filled, met)
        self._met, self._last = met[-1], filled[-1]
        return filled

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Fill a whole take."""
        self.start()
        found = measured_only(take.positions)
        return replace(found, positions=self.fill(take.positions))

    def step(self, observation: Observation) -> Correction:
        """Fill the next frame."""
        confidence = np.where(np.isnan(observation.positions[:, 0]), 0.0, 1.0)
        posture = self.follow(observation.positions, confidence)
        return Correction(posture, None, confidence, float("nan"))

    def follow(self, positions: Array, confidence: Array) -> Array:
        """Return the next frame [m], each joint as far held as it is not trusted.

        Args:
            positions: Joint positions [m], NaN only where the confidence is 0, (J, 3).
            confidence: Share of the measurement, in [0, 1], shape (J,).
        """
        posture = self._blend(self._last, positions, confidence)
        self._met = self._met | (confidence > 0.0)
        self._hang(posture[None], self._met[None])
        self._last = posture
        return posture
