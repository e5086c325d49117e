"""Which way a person faces, from what several sensors see.

A sensor sees people facing it, or away from it, as they are, but has people beside it
turned toward itself. So it counts by the square of the cosine of the angle from which
it would look at them; where sensors contradict each other, people turn no faster than
they have to.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array

from .sides import path_to

# Chosen on simulated people (seeds 140 to 145) and on p00 to p08 of two-kinects.
_COUNT = 72  # headings that are told apart
_TOLERANCE = np.radians(45.0)  # by which a heading may be off
_MOST = 4.0  # tolerances squared that a sensor may be off by
_TURNING = np.radians(100.0)  # rad/s at which turning costs as much as the tolerance
_GRID = 2.0 * np.pi * np.arange(_COUNT) / _COUNT


class Facing:
    """Follows which way a person faces, frame by frame (Viterbi 1967)."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._costs = np.zeros(_COUNT)

    def step(
        self, yaws: Array, angles: Array, elapsed: float
    ) -> tuple[float, NDArray[np.uint8]]:
        """Return the heading [rad], 0 along +z, as far as frames tell so far.

        And which of all headings led to each, for ``whole``.

        Args:
            yaws: Heading of what each sensor sees, with its sides put right, NaN where
                it sees nobody [rad], (S,).
            angles: Where each sensor is from the person [rad], (S,).
            elapsed: Time since the last frame [s].
        """
        turning = _wrapped(_GRID[:, None] - _GRID) / (_TURNING * max(elapsed, 1e-3))
        whole = self._costs[:, None] + turning**2
        away = np.minimum((_wrapped(yaws[:, None] - _GRID) / _TOLERANCE) ** 2, _MOST)
        views = np.cos(angles[:, None] - _GRID) ** 2
        costs = whole.min(axis=0) + np.nansum(views * away, axis=0)
        self._costs = costs - costs.min()
        return float(_GRID[costs.argmin()]), whole.argmin(axis=0).astype(np.uint8)

    def whole(self, frames: Iterable[tuple[Array, Array, float]]) -> Array:
        """Return the heading in each frame [rad], (T,), of what ``step`` takes."""
        self.start()
        came = [self.step(*frame)[1] for frame in frames]
        return np.asarray(_GRID[path_to(int(self._costs.argmin()), came)])


def _wrapped(angles: Array) -> Array:
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
