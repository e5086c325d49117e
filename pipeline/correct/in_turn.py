"""One correction method after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinefilter.characters.arrays import Array

from .interface import Correction, Corrector, Mover, Observation


class InTurn:
    """Shows each method what those before it made of the measurement.

    What was not measured stays unmeasured to all of them. The last one has the word on
    trust, rotations and coverage.

    Args:
        methods: The methods, in their order.
        least_rate: What reliability a measured joint has at least in the eyes of the
            last method, for methods before it that know what the sensor's guesses
            mean.
    """

    def __init__(
        self, methods: Sequence[Corrector], *, least_rate: float = 0.0
    ) -> None:
        self.methods = tuple(methods)
        self.least_rate = least_rate

    def start(self) -> None:
        """Forget all frames."""
        for method in self.methods:
            method.start()

    def ahead(self, positions: Array) -> tuple[Array, InTurn]:
        """Let the first methods move a whole take, as far as they can, at once.

        Args:
            positions: Joint positions [m], NaN where missing, shape (T, J, 3).

        Returns:
            The positions that they leave, and the methods that are left for them.
        """
        methods = self.methods
        while len(methods) > 1 and isinstance(methods[0], Mover):
            positions, methods = methods[0].move(positions), methods[1:]
        return positions, InTurn(methods, least_rate=self.least_rate)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        *before, last = self.methods
        missing = np.isnan(observation.positions)
        for method in before:
            made = method.step(observation).positions
            observation = replace(
                observation, positions=np.where(missing, np.nan, made)
            )
        if self.least_rate > 0.0:
            least = np.where(missing[:, 0], 0.0, self.least_rate)
            observation = replace(
                observation,
                rate=np.maximum(observation.rate, least),
                geometry=np.maximum(observation.geometry, least),
            )
        return last.step(observation)
