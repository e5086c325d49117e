"""Spans of frames in which something holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def runs(flags: NDArray[np.bool_], shortest: int = 1) -> list[slice]:
    """Return the spans in which flags, shape (T,), are true without a break.

    Args:
        flags: Whether it holds in each frame, shape (T,).
        shortest: Spans of fewer frames are left out.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    pairs = edges.reshape(-1, 2).tolist()
    return [slice(a, b) for a, b in pairs if b - a >= shortest]
