"""How hidden segments continue their own motion, without a database of postures.

Directions are unit vectors in the heading frame, arrays of shape (T, C) with the
components of one or more segments along C.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import solveh_banded

from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.target.smooth import penalty

REFERENCE_RATE = 30.0  # Hz: frame rate at which the smoothness is specified
CONTEXT = 0.2  # s on either side of a gap from which ``bridge_matrix`` bridges it
SPEED_FRAMES = 5  # over which the velocity at the end of a gap is measured
_SMOOTHNESS = 3.0  # lambda at 30 Hz, chosen on people 1 to 3 of six
_FORGET = 1.0  # s after which the velocity at the ends loses its effect in a long gap
_COAST = 0.2  # s: time constant with which a hidden segment comes to rest


def bridge(values: Array, known: Flags, rate: float) -> Array:
    """Return values with their gaps bridged smoothly from both ends, shape (T, C).

    Whittaker's smoother with second differences (Eilers 2003) minimizes the sum of
    |z - y|^2 over known frames plus lambda times the sum of |second difference|^2. In
    gaps much longer than a second, it approaches the straight line between the ends.
    ``known`` (T,) is True for known frames, at least one; the frame rate is in Hz.
    """
    seen = np.flatnonzero(known)
    first, last = seen[0], seen[-1] + 1
    bridged = np.empty_like(values)
    bridged[first:last] = _between(values[first:last], known[first:last], rate)
    # Before the first known frame and after the last one, only one end is known.
    inner = bridged[first:last]
    bridged[last:] = _coasted(inner, len(values) - last, rate)
    bridged[:first] = _coasted(inner[::-1], first, rate)[::-1]
    return bridged


def _coasted(values: Array, count: int, rate: float) -> Array:
    """Return the ``count`` frames after values (T, C) in which they come to rest."""
    before = values[max(len(values) - 1 - SPEED_FRAMES, 0)]
    velocity = (values[-1] - before) * rate / SPEED_FRAMES
    elapsed = np.arange(1, count + 1)[:, None] / rate
    return coast(values[-1], velocity, elapsed)


def _between(values: Array, known: Flags, rate: float) -> Array:
    """Return values (T, C) bridged; the first and the last one are known."""
    if known.all():
        return values
    frames = np.arange(len(values))
    lines = [np.interp(frames, frames[known], y[known]) for y in values.T]
    stiffness = _SMOOTHNESS * (rate / REFERENCE_RATE) ** 4
    weights = np.where(known, 1.0, stiffness / (_FORGET * rate) ** 4)
    bands = penalty(np.full(len(values) - 2, stiffness), (1.0, -2.0, 1.0))
    bands[0] += weights
    right = weights[:, None] * np.stack(lines, axis=1)
    solved = solveh_banded(bands, right, lower=True)
    return np.where(known[:, None], values, solved)


@lru_cache(maxsize=256)
def bridge_matrix(count: int, context: int, rate: float) -> Array:
    """Return ``bridge`` as the linear map that it is, shape (count, 2 context).

    It maps the ``context`` frames before and after a gap to its ``count`` frames.
    """
    known = np.ones(count + 2 * context, dtype=np.bool_)
    known[context : context + count] = False
    ends = np.zeros((len(known), 2 * context))
    ends[known] = np.eye(2 * context)
    return bridge(ends, known, rate)[~known]


def coast(last: Array, velocity: Array, elapsed: Array) -> Array:
    """Return where something that loses its velocity is after some time, (..., C).

    ``last`` is where it was, ``velocity`` is in 1/s, and ``elapsed`` [s] broadcasts.
    """
    return np.asarray(last + velocity * (_COAST * (1.0 - np.exp(-elapsed / _COAST))))
