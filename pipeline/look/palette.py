"""Colors of what is drawn, the same in videos, in the viewer and on the page."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

RELIABILITY = ("#d73027", "#fee090", "#3f74b5")
"""Reliability 0, 0.5 and 1: red, pale yellow and blue, which color-blind people can
tell apart."""
ORIGINS = ("#4d7fbf", "#f0a028", "#c8285a")
"""Joints that were measured, corrected and filled (Origin)."""
TERMS = ("#7b4fb5", "#d9622b", "#20908d", "#8a8f29")
"""Terms that decide reliability (Term); the others have UNKNOWN."""
UNKNOWN = "#999999"
"""What nothing is known about."""


def rgb(color: str) -> Array:
    """Return red, green and blue, 0 to 1, of a color such as #d73027, shape (3,)."""
    return np.array(list(bytes.fromhex(color[1:]))) / 255.0


def reliability_colors(reliability: Array) -> Array:
    """Return the colors of reliability in [0, 1] or NaN (unknown), shape (..., 3)."""
    low, middle, high = map(rgb, RELIABILITY)
    colors = [
        np.interp(reliability, (0.0, 0.5, 1.0), channel)
        for channel in zip(low, middle, high, strict=True)
    ]
    known = np.isfinite(reliability)[..., None]
    return np.where(known, np.stack(colors, axis=-1), rgb(UNKNOWN))
