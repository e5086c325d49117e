"""No correction: what was measured stays, what is missing keeps its last bones."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton, standard_body

from .blend import Blend
from .interface import Correction, Observation

__all__ = ["Hold"]


class Hold:
    """Passes measurements through and hangs missing joints on their last bones."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._blend = Blend(skeleton)
        rest = standard_body(skeleton).rest_positions
        self._rest = rest - rest[skeleton.root]
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._last = self._rest

    def step(self, observation: Observation) -> Correction:
        """Fill the next frame."""
        trust = np.where(np.isnan(observation.positions[:, 0]), 0.0, 1.0)
        self._last = self._blend(self._last, observation.positions, trust)
        return Correction(self._last, None, trust, float("nan"))
