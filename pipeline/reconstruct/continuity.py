"""Where a hidden segment points if it goes on as it went: no posture is looked up.

Directions are unit vectors in the heading frame, arrays of shape (T, C) with the
components of one or more segments along C.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import solveh_banded

from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.target.smooth import penalty

REFERENCE_RATE = 30.0
"""Frame rate [Hz] that the smoothness is given for."""
CONTEXT = 0.2
"""Time [s] on either side of a gap that the bridge looks at in a window."""
SPEED_FRAMES = 5
"""Frames over which a velocity at the end of a gap is taken."""
_SMOOTHNESS = 3.0  # lambda at 30 Hz, chosen on people 1 to 3 of six
_FORGET = 1.0  # s after which the speed at the ends no longer matters in a long gap
_COAST = 0.2  # s in which a segment that nobody sees comes to rest


def bridge(values: Array, known: Flags, rate: float) -> Array:
    """Return values with their gaps bridged smoothly from both ends, shape (T, C).

    Whittaker's smoother with second differences (Eilers 2003): it minimizes the sum of
    |z - y|^2 over known frames plus lambda times the sum of |second difference|^2. In
    gaps much longer than a second, the straight line between the ends takes over.

    Args:
        values: What to bridge, shape (T, C).
        known: The frames in which it is known, one or more, shape (T,).
        rate: Frame rate [Hz].
    """
    if known.all():
        return values.copy()
    seen = np.flatnonzero(known)
    first, last = seen[0], seen[-1] + 1
    bridged = np.empty_like(values)
    bridged[first:last] = _between(values[first:last], known[first:last], rate)
    # Before it was first seen and after it was last seen nobody knows the other end.
    inner = bridged[first:last]
    bridged[last:] = coasted(inner, len(values) - last, rate)
    bridged[:first] = coasted(inner[::-1], first, rate)[::-1]
    return bridged


def coasted(values: Array, count: int, rate: float) -> Array:
    """Return the ``count`` frames after values (T, C) that come to rest, (count, C)."""
    before = values[max(len(values) - 1 - SPEED_FRAMES, 0)]
    velocity = (values[-1] - before) * rate / SPEED_FRAMES
    elapsed = np.arange(1, count + 1)[:, None] / rate
    return coast(values[-1], velocity, elapsed)


def _between(values: Array, known: Flags, rate: float) -> Array:
    """Return values whose first and last are known, bridged, shape (T, C)."""
    count, frames = len(values), np.arange(len(values))
    if known.all():
        return values
    line = np.stack(
        [np.interp(frames, frames[known], y[known]) for y in values.T], axis=1
    )
    stiffness = _SMOOTHNESS * (rate / REFERENCE_RATE) ** 4
    weights = np.where(known, 1.0, stiffness / (_FORGET * rate) ** 4)
    bands = penalty(np.full(count - 2, stiffness), (1.0, -2.0, 1.0))
    bands[0] += weights
    solved = solveh_banded(bands, weights[:, None] * line, lower=True)
    return np.where(known[:, None], values, solved)


@lru_cache(maxsize=256)
def bridge_matrix(count: int, context: int, rate: float) -> Array:
    """Return the matrix that makes the frames of a gap of those around it.

    Shape (count, 2 context): what ``bridge`` does, as the linear map that it is.
    """
    known = np.ones(count + 2 * context, dtype=np.bool_)
    known[context : context + count] = False
    ends = np.zeros((len(known), 2 * context))
    ends[known] = np.eye(2 * context)
    return bridge(ends, known, rate)[~known]


def coast(last: Array, velocity: Array, elapsed: Array) -> Array:
    """Return where something goes that loses its speed, like a limb let alone.

    Args:
        last: Where it was, shape (..., C).
        velocity: How fast it was [1/s], shape (..., C).
        elapsed: Time since then [s], broadcastable to the others.
    """
    return np.asarray(last + velocity * (_COAST * (1.0 - np.exp(-elapsed / _COAST))))
