"""No correction: what was measured stays, what is missing keeps its last bones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array

from .blend import Blend
from .interface import Correction, Corrector, Observation, measured_only


class Hold(Corrector):
    """Passes measurements through and hangs missing joints on their last bones."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._blend = Blend(skeleton)
        rest = standard_body(skeleton).rest_positions
        self._rest = rest - rest[skeleton.root]
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._last = self._rest

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
        self._last = filled[-1]
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
        trust = np.where(np.isnan(observation.positions[:, 0]), 0.0, 1.0)
        self._last = self._blend(self._last, observation.positions, trust)
        return Correction(self._last, None, trust, float("nan"))
