"""Limbs that the sensor has not seen at all: they go where people mostly have them.

Legs behind a desk are an example. There is no motion to continue, so that networks
predict their directions from the posture of the rest of the body.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import unit
from kinefilter.retarget import HeadingFrame, find_yaw

from .limbs import in_limbs, limbs
from .prior import MotionPrior, standing_height

_SMOOTHED = 0.2  # s: standard deviation of the filter over predicted directions. Chosen
# on s02, s03, s04 and a quarter of the other people.


def point_unseen(
    bones: Array, unseen: Flags, lower: Array, body: Body, prior: MotionPrior
) -> Flags:
    """Point the segments of ``unseen`` limbs (J,) to where they likely are, in place.

    ``bones`` (..., J, 3) and ``lower`` (...) are as for ``posture_inputs``. Returns the
    segments that now have directions, (J,).
    """
    known, skeleton = bones.copy(), body.skeleton
    known[..., unseen, :] = np.nan
    pointed = np.zeros(len(unseen), dtype=np.bool_)
    for _, *joints in limbs(skeleton):
        hidden = tuple(j for j in joints if unseen[j])
        directions = prior.unseen(skeleton, hidden, known, lower)
        if directions is not None:
            segments = list(hidden)
            bones[..., segments, :] = body.lengths[segments, None] * directions
            pointed[segments] = True
    return pointed


def fill_unseen(
    time: Array, positions: Array, unseen: Flags, body: Body, prior: MotionPrior
) -> tuple[Array, Flags]:
    """Return positions [m] with unseen limbs filled, and flags (J,) of these joints.

    Positions (T, J, 3) are in the sensor frame with y up, time stamps [s] increase
    strictly, and ``unseen`` are the joints that the take never shows, shape (J,).
    """
    skeleton, root = body.skeleton, positions[:, body.skeleton.root]
    if not unseen[in_limbs(skeleton)].any() or np.isnan(root).any():
        return positions, np.zeros_like(unseen)
    weights = np.ones(positions.shape[:2])
    heading = HeadingFrame(root, np.nan_to_num(find_yaw(positions, weights, skeleton)))
    placed = heading.remove(positions)
    bones = placed - placed[:, skeleton.parents]
    lower = root[:, 1] - standing_height(root[:, 1])
    pointed = point_unseen(bones, unseen, lower, body, prior)
    spread = _SMOOTHED / nominal_step(time)
    smoothed = gaussian_filter1d(bones[:, pointed], spread, axis=0, mode="nearest")
    bones[:, pointed] = body.lengths[pointed, None] * unit(smoothed)
    for j in skeleton.order:
        if pointed[j]:
            placed[:, j] = placed[:, skeleton.parents[j]] + bones[:, j]
    return np.where(pointed[:, None], heading.restore(placed), positions), pointed
