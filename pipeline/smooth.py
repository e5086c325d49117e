"""Zero-lag smoothing of a whole take.

Whittaker's smoother: it minimizes sum of w |z - y|^2 + lambda sum of |third
difference of z|^2, so it has no lag, keeps quadratic motion exactly, and bridges what
has little weight (Eilers 2003, A perfect smoother, Anal. Chem. 75).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

__all__ = ["smooth"]

Array = NDArray[np.float64]

_ORDER = 3
_LONGEST_GAP = 30  # missing frames that a gap is bridged with; a longer one shrinks


def smooth(time: Array, values: Array, weights: Array, *, cutoff: float) -> Array:
    """Return smoothed values.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        values: What to smooth, shape (T, J, C).
        weights: Trust in each value, in [0, 1], over 0, shape (T, J).
        cutoff: Frequency [Hz] at which half of the amplitude of a fully trusted value
            is left; trust w moves it by a factor of w^(1/6).
    """
    count = len(time)
    steps = np.diff(time)
    if count <= _ORDER or cutoff >= 0.5 / np.median(steps):
        return values.copy()
    grid = np.concatenate([[0], np.cumsum(_frames(steps))])
    length = int(grid[-1]) + 1
    # A sine of the cutoff frequency keeps 1 / (1 + lambda |2 sin(w/2)|^6) = 1/2.
    stiffness = (2.0 * np.sin(np.pi * cutoff * float(np.median(steps)))) ** (
        -2 * _ORDER
    )
    bands = stiffness * _penalty(length)
    smoothed = np.empty_like(values)
    for j in range(values.shape[1]):
        system = bands.copy()
        system[0, grid] += weights[:, j]
        right = np.zeros((length, values.shape[2]))
        right[grid] = weights[:, j, None] * values[:, j]
        smoothed[:, j] = solveh_banded(system, right, lower=True)[grid]
    return smoothed


def _frames(steps: Array) -> NDArray[np.intp]:
    """Return how many nominal frames each time step spans, at least one."""
    frames = np.round(steps / np.median(steps))
    return np.clip(frames, 1, _LONGEST_GAP).astype(np.intp)


def _penalty(length: int) -> Array:
    """Return the lower bands of D'D, D the third-difference matrix, (4, length)."""
    row = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((_ORDER + 1, length))
    rows = length - _ORDER
    for a in range(_ORDER + 1):
        for b in range(a + 1):
            bands[a - b, b : b + rows] += row[a] * row[b]
    return bands
