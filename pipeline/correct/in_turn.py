"""One correction method after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .interface import Correction, Corrector, Observation

__all__ = ["InTurn"]


class InTurn:
    """Shows each method what those before it made of the measurement.

    What was not measured stays unmeasured to all of them. The last one has the word on
    trust, rotations and coverage.

    Args:
        methods: The methods, in their order.
    """

    def __init__(self, methods: Sequence[Corrector]) -> None:
        self.methods = tuple(methods)

    def start(self) -> None:
        """Forget all frames."""
        for method in self.methods:
            method.start()

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        *before, last = self.methods
        missing = np.isnan(observation.positions)
        for method in before:
            made = method.step(observation).positions
            observation = replace(
                observation, positions=np.where(missing, np.nan, made)
            )
        return last.step(observation)
