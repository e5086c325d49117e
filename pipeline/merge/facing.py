"""Which way a person faces, from what several sensors see.

A sensor sees people facing it, or away from it, as they are, but has people beside it
turned toward itself. So it counts by the square of the cosine of the angle from which
it would look at them; where sensors contradict each other, people turn no faster than
they have to.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array

from .sides import CheapestPath

# Chosen on simulated people (seeds 140 to 145) and on p00 to p08 of two-kinects.
_TOLERANCE = np.radians(45.0)  # by which a heading may be off
_MOST = 4.0  # tolerances squared that a sensor may be off by
_TURNING = np.radians(100.0)  # rad/s at which turning costs as much as the tolerance
_GRID = 2.0 * np.pi * np.arange(72) / 72  # headings that are told apart


class Facing(CheapestPath):
    """Follows which way a person faces, a heading [rad], 0 along +z."""

    def __init__(self) -> None:
        super().__init__(_GRID)

    def step(
        self, yaws: Array, angles: Array, elapsed: float
    ) -> tuple[Any, NDArray[np.uint16]]:
        """Return the heading as far as frames tell so far.

        Args:
            yaws: Heading of what each sensor sees, with its sides put right, NaN where
                it sees nobody [rad], (S,).
            angles: Where each sensor is from the person [rad], (S,).
            elapsed: Time since the last frame [s].
        """
        turning = _wrapped(_GRID[:, None] - _GRID) / (_TURNING * max(elapsed, 1e-3))
        away = np.minimum((_wrapped(yaws[:, None] - _GRID) / _TOLERANCE) ** 2, _MOST)
        views = np.cos(angles[:, None] - _GRID) ** 2
        return self._next(turning**2, np.nansum(views * away, axis=0))


def _wrapped(angles: Array) -> Array:
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
