"""A hidden foot that stood stays where it stood; its knee bends by itself."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.retarget.bent_limb import bent_limb

_RESTS = 1.0  # m/s: an ankle that is much slower than that stands
_LOW = 0.3  # m over the floor: an ankle much lower than that stands
_NEAR = 0.3  # m between both ends: a foot that ends much nearer has not stepped
_LEAVES = 1.0 / 3.0  # s that a foot that steps meanwhile still counts as standing
_STANDING = 10.0  # percentile of the ankles' heights that is taken for standing
_STRAIGHT = 0.999  # of a leg's length, the farthest that its ankle goes


def standing_height(heights: Array) -> float:
    """Return the height of a standing ankle from those of both [m]; 0 if unseen."""
    return float(np.percentile(heights, _STANDING)) if heights.size else 0.0


def standing(ankle: Array, rate: float, floor: float) -> Array:
    """Return how surely an ankle stands at one end of a gap, in [0, 1], shape (...).

    Args:
        ankle: Its places in the frames before or after [m], world, shape (..., N, 3).
        rate: Frame rate [Hz].
        floor: Height of a standing ankle [m].
    """
    steps = np.linalg.norm(np.diff(ankle, axis=-2), axis=-1)
    speed = rate * np.median(steps, axis=-1)
    lift = np.maximum(ankle[..., 1].mean(axis=-1) - floor, 0.0)
    return np.asarray(np.exp(-((speed / _RESTS) ** 2) - (lift / _LOW) ** 2))


def hold_place(
    last: Array, after: Array | None, stood: Array, stands: Array, time: Array
) -> tuple[Array, Array]:
    """Return where a hidden ankle is held and how firmly, in [0, 1].

    Args:
        last: Place when last seen [m], world, shape (..., 1, 3).
        after: Place when next seen; None where nobody knows.
        stood: How surely it stood when last seen, shape (..., 1).
        stands: How surely it stands when next seen, shape (..., 1).
        time: Times since it was last seen, and until it is next seen [s], (2, ..., N).
    """
    since, until = time
    leaves = stood * np.exp(-since / _LEAVES)
    if after is None:
        return np.broadcast_to(last, (*since.shape, 3)), stood * np.ones_like(since)
    way = after - last
    near = np.exp(-((np.linalg.norm(way, axis=-1) / _NEAR) ** 2))
    share = (since / (since + until))[..., None]
    firm = stood * stands * near
    firm = firm + (1.0 - near) * (leaves + stands * np.exp(-until / _LEAVES))
    return last + share * way, np.clip(firm, 0.0, 1.0)


def bent(
    hip: Array, knee: Array, ankle: Array, goal: Array, lengths: tuple[float, float]
) -> tuple[Array, Array]:
    """Return knee and ankle [m] of a leg whose ankle goes to a goal, shapes (..., 3).

    The knee turns as little as it can. Where goal and ankle agree, both stay.
    """
    was, now = (between_ends(hip, knee, end, lengths) for end in (ankle, goal))
    return knee + now[0] - was[0], ankle + now[1] - was[1]


def between_ends(
    top: Array, middle: Array, end: Array, lengths: tuple[float, float]
) -> tuple[Array, Array]:
    """Return an elbow or knee [m] about there, and the end as far as it is in reach."""
    # Of a straight leg the knee goes to the front, +z.
    toward = middle - top + np.array([0.0, 0.0, 0.05])
    least = abs(lengths[0] - lengths[1]) + 1e-3
    return bent_limb(top, end, toward, lengths, (least, _STRAIGHT * sum(lengths)))
