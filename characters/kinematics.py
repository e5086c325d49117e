"""Forward kinematics: segment rotations and a root to joint positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .anthropometry import Body
from .rotations import rotate


def positions_from_rotations(
    rotations: NDArray[np.float64], root: NDArray[np.float64], body: Body
) -> NDArray[np.float64]:
    """Return joint positions of a body.

    Args:
        rotations: World rotation of the segment that ends at each joint, unit
            quaternions wxyz, identity in the T-pose, shape (..., J, 4).
        root: Position of the root joint [m], world frame, shape (..., 3).
        body: Whose segments they are.

    Returns:
        Joint positions [m], world frame, shape (..., J, 3).
    """
    bones = rotate(rotations, body.rest_offsets)
    positions = np.empty_like(bones)
    skeleton = body.skeleton
    positions[..., skeleton.root, :] = root
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        positions[..., j, :] = positions[..., p, :] + bones[..., j, :]
    return positions
