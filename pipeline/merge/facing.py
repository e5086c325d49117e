"""Finds which way a person faces whom several sensors see.

A sensor sees people who face it, or face away, as they are, but shows people at its
side turned toward itself. So each is weighted by the squared cosine of the angle from
which it would look at them; where sensors contradict each other, people turn no faster
than they have to: the heading is the cheapest path over all frames (Viterbi 1967), or,
live, the cheapest path so far.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import wrapped
from kinefilter.pipeline.failures.sides import CheapestPath

# Chosen on simulated people (seeds 40 to 51 and 140 to 145) and on p00 to p08 of
# two-kinects.
_TOLERANCE = np.radians(45.0)  # rad by which a heading may be off
_MAX_COST = 4.0  # in squared tolerances, of one sensor
_TURNING = np.radians(100.0)  # rad/s at which turning costs as much as the tolerance
_GRID = 2.0 * np.pi * np.arange(72) / 72  # headings to choose from [rad]


class Facing(CheapestPath):
    """Follows a person's heading [rad], 0 along +z."""

    def __init__(self) -> None:
        super().__init__(_GRID)

    def step(
        self, yaws: Array, angles: Array, elapsed: float
    ) -> tuple[Any, NDArray[np.uint16]]:
        """Return the heading, given the frames so far; see ``CheapestPath.step``.

        ``yaws`` are the headings in each sensor [rad], without swapped sides, NaN where
        it sees no one, and ``angles`` the directions to each sensor [rad], both (S,).
        """
        turning = wrapped(_GRID[:, None] - _GRID) / (_TURNING * max(elapsed, 1e-3))
        errors = wrapped(yaws[:, None] - _GRID) / _TOLERANCE
        views = np.cos(angles[:, None] - _GRID) ** 2
        costs = np.nansum(views * np.minimum(errors**2, _MAX_COST), axis=0)
        return self._next(turning**2, costs)
