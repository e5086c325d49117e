"""The foot of one stance, at rest."""

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array

from .possible_postures import standing_direction


def flat_height(body: Body, toe: int) -> float:
    """Return the height [m] of the ankle of a foot that is flat on the floor."""
    ankle = float(body.rest_positions[body.skeleton.parents[toe], 1])
    return min(ankle, float(body.radii[toe] + body.lengths[toe]))


def resting(
    path: Array, weights: Array, rise: Array, yaw: Array, body: Body, toe: int
) -> Array:
    """Return ankle and toe of one stance [m], shape (T, 2, 3).

    The ankle is over its weighted median, and rises [m] (T,) while the toes are on the
    floor, which is at y = 0. ``yaw`` is where the hips head [rad] in the frames in
    which the shank is upright.
    """
    place = [_median(path[:, 0, axis], weights) for axis in (0, 2)]
    ahead = np.median(path[:, 1] - path[:, 0], axis=0)[[0, 2]]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    if len(yaw):
        ahead = standing_direction(ahead, yaw)
    length, sole, flat = body.lengths[toe], body.radii[toe], flat_height(body, toe)
    reach = np.sqrt(max(length**2 - (flat - sole) ** 2, 0.0))
    tip, rest = place + reach * ahead, np.zeros((len(path), 2, 3))
    rest[:, 1, [0, 2]], rest[:, 1, 1] = tip, sole
    # The ankle turns about the toes.
    height = np.minimum(flat + rise, sole + length)
    back = np.sqrt(np.maximum(length**2 - (height - sole) ** 2, 0.0))
    rest[:, 0, [0, 2]], rest[:, 0, 1] = tip - back[:, None] * ahead, height
    return rest


def _median(values: Array, weights: Array) -> float:
    """Return the weighted median, the mean of two values if both are in the middle."""
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order] + 1e-3)
    half, rounding = 0.5 * sums[-1], 1e-9 * sums[-1]
    middle = np.searchsorted(sums, [half - rounding, half + rounding])
    return float(values[order][middle].mean())
