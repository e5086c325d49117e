"""How reliable a joint is, as a color."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

_SHARES = (0.0, 0.5, 1.0)
_COLORS = np.array([[215, 48, 39], [254, 224, 144], [63, 116, 181]]) / 255.0


def reliability_colors(reliability: Array) -> Array:
    """Return colors from red over pale yellow to blue.

    Those of the report (``report/template/arrays.js``), which color-blind people tell
    apart.

    Args:
        reliability: Rates, cut to 0 (red) and 1 (blue), any shape (...).

    Returns:
        Red, green and blue, 0 to 1, shape (..., 3).
    """
    return np.stack(
        [np.interp(reliability, _SHARES, color) for color in _COLORS.T], axis=-1
    )
