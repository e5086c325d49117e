"""A hidden foot that was planted stays in place, and its knee bends to suit."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.retarget.bent_limb import bent_limb

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
