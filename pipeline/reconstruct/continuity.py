"""How hidden segments continue their own motion, and hidden planted feet stay.

Directions are unit vectors in the heading frame, arrays of shape (T, C) with the
components of one or more segments along C.
"""

from functools import lru_cache

import numpy as np
from scipy.linalg import solveh_banded

from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.target.smooth import penalty
from kinefilter.retarget.limbs import bent_limb

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


_RESTS = 1.0  # m/s: an ankle much slower than this is planted
_LOW = 0.3  # m above the floor: an ankle much lower than this is planted
_NEAR = 0.3  # m between both ends of a gap: a foot that moves much less does not step
_LEAVES = 1.0 / 3.0  # s in which a foot that steps during the gap stops being planted
_PLANTED = 10.0  # percentile of the ankles' heights that counts as planted
_STRAIGHT = 0.999  # of the leg's length: the greatest distance from hip to ankle


def planted_height(heights: Array) -> float:
    """Return the height of a planted ankle from those of both [m]; 0 without any."""
    return float(np.percentile(heights, _PLANTED)) if heights.size else 0.0


def planted_likelihood(ankle: Array, rate: float, floor: float) -> Array:
    """Return how likely an ankle is planted at one end of a gap, in [0, 1], (...).

    ``ankle`` (..., N, 3) holds its positions there [m], world frame, at a frame rate of
    ``rate`` [Hz]; ``floor`` is the height of a planted ankle [m].
    """
    steps = np.linalg.norm(np.diff(ankle, axis=-2), axis=-1)
    speed = rate * np.median(steps, axis=-1)
    lift = np.maximum(ankle[..., 1].mean(axis=-1) - floor, 0.0)
    return np.asarray(np.exp(-((speed / _RESTS) ** 2) - (lift / _LOW) ** 2))


def held_ankle(
    last: Array, after: Array | None, planted: list[Array], time: Array
) -> tuple[Array, Array]:
    """Return where a hidden ankle is held [m], and how firmly, in [0, 1].

    ``last`` and ``after`` (None if unknown) are its positions before and after the gap
    [m], world frame, (..., 1, 3), ``planted`` the likelihoods that it is planted there,
    (..., 1), and ``time`` those since and until it is seen [s], (2, ..., N).
    """
    since, until = time
    if after is None:
        held = np.broadcast_to(last, (*since.shape, 3))
        return held, planted[0] * np.ones_like(since)
    was_planted, is_planted = planted
    way = after - last
    near = np.exp(-((np.linalg.norm(way, axis=-1) / _NEAR) ** 2))
    share = (since / (since + until))[..., None]
    leaves, arrives = (np.exp(-t / _LEAVES) for t in (since, until))
    firm = was_planted * is_planted * near
    firm = firm + (1.0 - near) * (was_planted * leaves + is_planted * arrives)
    return last + share * way, np.clip(firm, 0.0, 1.0)


def leg_to_goal(
    hip: Array, knee: Array, ankle: Array, goal: Array, lengths: tuple[float, float]
) -> tuple[Array, Array]:
    """Return knee and ankle [m] of a leg whose ankle goes to a goal, shapes (..., 3).

    The knee turns as little as possible. Where goal and ankle agree, both stay.
    """
    was, now = (middle_joint(hip, knee, end, lengths) for end in (ankle, goal))
    return knee + now[0] - was[0], ankle + now[1] - was[1]


def middle_joint(
    top: Array, middle: Array, end: Array, lengths: tuple[float, float]
) -> tuple[Array, Array]:
    """Return an elbow or knee [m] bent toward ``middle``, and the end within reach."""
    # The knee of a straight leg bends to the front, +z.
    toward = middle - top + np.array([0.0, 0.0, 0.05])
    least = abs(lengths[0] - lengths[1]) + 1e-3
    return bent_limb(top, end, toward, lengths, (least, _STRAIGHT * sum(lengths)))
