"""What Shum 2013 compares with, section VIII.B: methods A and B."""

from __future__ import annotations

import numpy as np

from kinefilter.pipeline.correct.interface import Correction, Corrector, Observation
from kinefilter.pipeline.correct.local_pca import LocalPCA
from kinefilter.pipeline.database import PostureDatabase


class Nearest(Corrector):
    """Method A (Shum & Ho 2012): the database posture most like what was tracked.

    Args:
        database: Natural postures.
    """

    def __init__(self, database: PostureDatabase) -> None:
        self.database = database

    def start(self) -> None:
        """Forget nothing: every frame is searched for by itself."""

    def step(self, observation: Observation) -> Correction:
        """Look up the next frame."""
        present = 1.0 - np.isnan(observation.positions[:, 0])
        (k,) = self.database.neighbors(observation.positions, present, 1)[0]
        trust = np.zeros(len(present))
        return Correction(
            self.database.positions[k].astype(float),
            self.database.rotations[k].astype(float),
            trust,
            float("nan"),
        )


class NoReliability(LocalPCA):
    """Method B: the posture of least energy, every tracked part trusted alike.

    Args:
        database: Natural postures.
    """

    def __init__(self, database: PostureDatabase) -> None:
        super().__init__(database, neighbors=30)  # as in table V

    def step(self, observation: Observation) -> Correction:
        """Synthesize the next frame."""
        present = 1.0 - np.isnan(observation.positions[:, 0])
        posture, nearest = self.synthesize(observation.positions, present)
        rotations = self.orientation(posture, nearest, present)
        return Correction(posture, rotations, np.zeros(len(present)), float("nan"))
