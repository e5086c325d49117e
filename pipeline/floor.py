"""Where the floor is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body

from .contacts import ankles_and_toes

__all__ = ["floor_height", "put_on_floor"]

Array = NDArray[np.float64]

_STANDING = 10.0  # percentile of the lowest sole that is taken for standing: above
# the frames in which the tracker lets a foot sink


def floor_height(
    positions: Array, trust: Array, stands: NDArray[np.bool_], body: Body
) -> float:
    """Return the height [m] of the floor under a take.

    The median over all feet that stand, by how high their ankles are over the floor.
    Where none does, the lower sole of each frame, at the height it has on the body when
    standing, and of all frames the 10th percentile. Joints that were measured count;
    where no foot ever was, the lowest joint of the body serves.

    Args:
        positions: Joint positions [m], y up, shape (T, J, 3).
        trust: Share of the measurement in each joint, shape (T, J).
        stands: Whether each foot stands, shape (T, 2).
        body: Whose ankles and feet are how high over the floor.
    """
    skeleton = body.skeleton
    feet = [
        skeleton.index(part + side)
        for part in ("Ankle", "Foot")
        for side in ("Left", "Right")
    ]
    heights = positions[..., 1] - body.rest_positions[:, 1]
    ankles, _ = ankles_and_toes(skeleton)
    standing = heights[:, ankles][stands & (trust[:, ankles] >= 0.5)]
    standing = standing[~np.isnan(standing)]
    if len(standing) > 0:
        return float(np.median(standing))
    seen = np.where(trust[:, feet] >= 0.5, heights[:, feet], np.nan)
    frames = ~np.isnan(seen).all(axis=1)
    if frames.any():
        return float(np.percentile(np.nanmin(seen[frames], axis=1), _STANDING))
    return float((positions[..., 1] - body.radii).min())


def put_on_floor(positions: Array, body: Body) -> Array:
    """Return positions (T, J, 3) with no capsule that ends at a joint under y = 0."""
    skeleton = body.skeleton
    clearance = body.radii.copy()
    np.maximum.at(clearance, skeleton.segment_parents, body.radii[skeleton.segments])
    lifted = positions.copy()
    np.maximum(lifted[..., 1], clearance, out=lifted[..., 1])
    return lifted
