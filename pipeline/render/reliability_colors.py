"""How reliable a joint is, as a color."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["reliability_colors"]

Array = NDArray[np.float64]

_UNRELIABLE, _RELIABLE = np.array([0.90, 0.15, 0.12]), np.array([0.16, 0.68, 0.20])


def reliability_colors(reliability: Array) -> Array:
    """Return colors from red over yellow to green.

    Args:
        reliability: Rates, cut to 0 (red) and 1 (green), any shape (...).

    Returns:
        Red, green and blue, 0 to 1, shape (..., 3).
    """
    share = np.clip(reliability, 0.0, 1.0)[..., None]
    mixed = _UNRELIABLE + share * (_RELIABLE - _UNRELIABLE)
    mixed[..., :2] += (share * (1.0 - share)) * 1.1  # or the middle would be brown
    return np.asarray(np.minimum(mixed, 1.0))
