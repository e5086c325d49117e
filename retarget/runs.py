"""Spans of frames in which something holds."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Flags


def runs(flags: Flags, shortest: int = 1) -> list[slice]:
    """Return the spans of ``shortest`` or more frames in which flags (T,) are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    pairs = edges.reshape(-1, 2)
    long = pairs[pairs[:, 1] - pairs[:, 0] >= shortest]
    return [slice(a, b) for a, b in long.tolist()]
