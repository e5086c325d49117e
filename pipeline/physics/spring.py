"""A critically damped spring, whose motion over any time step is known exactly."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array


def damped(
    off: Array, speed: Array, frequency: float, dt: float
) -> tuple[Array, Array]:
    """Return the distance from rest [m] and the velocity [m/s] ``dt`` [s] later.

    ``frequency`` is the natural frequency of the spring [rad/s].
    """
    drift, decay = speed + frequency * off, np.exp(-frequency * dt)
    later = off + drift * dt
    return later * decay, (drift - frequency * later) * decay
