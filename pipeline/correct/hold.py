"""Blending a prior posture with a measured one, and filling missing joints."""

from dataclasses import replace
from typing import Any

import numpy as np

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags, solved
from kinefilter.characters.rotations import between, rotate

from .interface import Correction, Corrector, Frames, Observation, measured_only

UNRELIABLE, RELIABLE = 0.3, 0.95
"""Reliability up to which a measurement is ignored, and from which it is kept as it is.
Limits of 0.6 and 0.85 remove less of the error of simulated takes; they, and 0.4 and
0.95, do more harm to recorded people. Chiang's single threshold of 0.7 loses most of
the benefit."""

_FIRMEST = 1e3  # weight of a fully trusted joint, against the pull of one bone


def measurement_confidence(
    reliability: Array, geometry: Array, missing: Flags, coverage: Any
) -> Array:
    """Return how closely each joint follows its measurement, in [0, 1], shape (..., J).

    Reliable joints stay where they are. Unreliable ones follow the prior to the extent
    that it knows the posture (``coverage``); where it does not, they stay near the
    measurement to the extent that the positions alone look plausible (``geometry``).
    """
    span = RELIABLE - UNRELIABLE
    confidence = ((reliability - UNRELIABLE) / span).clip(0.0, 1.0)
    plausible = ((geometry - UNRELIABLE) / span).clip(0.0, 1.0)
    confidence = confidence + (1.0 - confidence) * (1.0 - coverage) * plausible
    return np.where(missing, 0.0, confidence)


class Blend:
    """Moves a prior posture onto the trusted joints of a measured one.

    The residual (measured minus prior) of trusted joints spreads over the skeleton to
    the others: it minimizes sum of w_j |r_j - residual_j|^2 + sum over bones of
    |r_j - r_parent|^2 with w = c / (1 - c) and the confidence c. Trusted joints end up
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
        """Return the blended postures [m], shape (..., J, 3).

        ``measured`` may be NaN where its share, ``confidence`` (..., J), is 0.
        """
        if confidence.min() >= 1.0:
            return measured.copy()
        residual = np.where(confidence[..., None] > 0.0, measured - prior, 0.0)
        weights = confidence / np.maximum(1.0 - confidence, 1.0 / _FIRMEST)
        own = np.eye(confidence.shape[-1]) * (weights + 1e-6)[..., None]
        blended = prior + solved(self._laplacian + own, weights[..., None] * residual)
        # Fully trusted joints stay exactly where they were measured.
        return np.where(confidence[..., None] >= 1.0, measured, blended)


class Hold(Corrector):
    """Corrects nothing: measured joints stay, missing ones keep their last bones.

    Hands and feet that have not been measured yet extend the forearm or shin as in the
    rest pose.

    Attributes:
        last: The last frame [m], shape (J, 3); at first the rest pose.
        measured: Whether each joint was measured so far, shape (J,).
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._blend = Blend(skeleton)
        rest = standard_body(skeleton).rest_positions
        self._rest = rest - rest[skeleton.root]
        self._parents = skeleton.parents
        ends = [*skeleton.sides("Wrist"), *skeleton.sides("Ankle")]
        self._tips = [tip for end in ends for tip in skeleton.descendants(end)]
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self.last: Array = self._rest
        self.measured = np.zeros(len(self._rest), dtype=np.bool_)

    def _extend(self, postures: Array, measured: Flags) -> None:
        """Place hands and feet that were not ``measured`` yet in postures (T, J, 3)."""
        for j in self._tips if not measured.all() else ():
            unknown = ~measured[:, j]
            if unknown.any():
                posture, p = postures[unknown], self._parents[j]
                above = self._parents[p]
                rest = self._rest[p] - self._rest[above]
                turn = between(rest, posture[:, p] - posture[:, above])
                own = rotate(turn, self._rest[j] - self._rest[p])
                postures[unknown, j] = posture[:, p] + own

    def fill(self, positions: Array) -> Array:
        """Return the next frames [m], (T, J, 3), with NaN filled as by ``step``."""
        filled = positions.copy()
        missing = np.asarray(~np.isfinite(positions).all(axis=-1))
        for k in np.flatnonzero(missing.any(axis=1)):
            last = filled[k - 1] if k else self.last
            filled[k] = self._blend(last, positions[k], np.where(missing[k], 0.0, 1.0))
        measured = np.logical_or.accumulate(np.vstack([self.measured, ~missing]))[1:]
        self._extend(filled, measured)
        self.measured, self.last = measured[-1], filled[-1]
        return filled

    def whole(self, take: Observation, frames: Frames = None) -> Correction:  # noqa: ARG002 - no loop
        """Fill a whole take."""
        self.start()
        seen = take.positions
        return replace(measured_only(seen), positions=self.fill(seen))

    def step(self, observation: Observation) -> Correction:
        """Fill the next frame."""
        confidence = np.where(np.isnan(observation.positions[:, 0]), 0.0, 1.0)
        posture = self.follow(observation.positions, confidence)
        return Correction(posture, confidence, float("nan"))

    def follow(self, positions: Array, confidence: Array) -> Array:
        """Return the next frame [m]; the less a joint is trusted, the more it is held.

        Positions (J, 3) may be NaN where their share, ``confidence`` (J,), is 0.
        """
        self.last = self._blend(self.last, positions, confidence)
        self.measured = self.measured | (confidence > 0.0)
        self._extend(self.last[None], self.measured[None])
        return self.last
