"""The way from 0 to 1 that begins and ends at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def smooth_step(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0 up to 0 and 1 from 1 on, between them the cubic level at both ends."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))
