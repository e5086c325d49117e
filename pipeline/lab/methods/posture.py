"""Shum 2013 as printed, and methods A and B, which the paper compares it with."""

from collections.abc import Iterable

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Corrector, LocalPCA, Observation
from kinefilter.pipeline.database import PostureDatabase


class LeastEnergy(LocalPCA):
    """Replaces the posture by the one of least energy in the natural posture space.

    Shum, Ho, Jiang & Takagi 2013: every joint is replaced, reliable or not.
    ``LocalPCA`` instead keeps reliable joints where they are, and relies on the
    measurement where the database has no similar posture.
    """

    def _correct(self, take: Observation, frames: Iterable[int]) -> Correction:
        weights = self._weights(take)
        postures, nearest = self._synthesize_each(take.positions, weights, frames)
        rotations = self.orientation(postures, nearest, weights)
        unknown = np.full(len(postures), np.nan)
        return Correction(postures, rotations, 0.0 * weights, unknown)

    def _weights(self, observation: Observation) -> Array:
        return observation.reliability * _present(observation)


class NoReliability(LeastEnergy):
    """Shum's method B: ``LeastEnergy`` with every measured joint trusted equally."""

    def _weights(self, observation: Observation) -> Array:
        return _present(observation)


class Nearest(Corrector):
    """Returns the most similar posture of the database, method A in Shum 2013."""

    def __init__(self, database: PostureDatabase) -> None:
        self.database = database

    def step(self, observation: Observation) -> Correction:
        """Look up the next frame, independently of earlier ones."""
        weights = _present(observation)
        (k,) = self.database.neighbors(observation.positions, weights, 1)[0]
        return Correction(
            self.database.positions[k].astype(float),
            self.database.rotations[k].astype(float),
            0.0 * weights,
            float("nan"),
        )


def _present(observation: Observation) -> Array:
    """Return 1 for each joint that was measured, otherwise 0, shape (..., J)."""
    return np.where(np.isnan(observation.positions[..., 0]), 0.0, 1.0)
