"""Where a take happens in a scene: the person begins at the scene's origin."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.retarget import HeadingFrame, find_yaw

_FIRST_FRAMES = 15  # half a second, in which people do not walk far


def place_of(positions: Array, skeleton: Skeleton) -> HeadingFrame:
    """Return where a motion begins: what ``remove`` takes out lands it in a scene.

    In a scene the person stands at the origin and faces +z (MuJoCo's +x).

    Args:
        positions: Joint positions [m], floor at y = 0, shape (T, J, 3).
        skeleton: The joints.
    """
    first = np.median(positions[:_FIRST_FRAMES], axis=0)
    yaw = find_yaw(first, np.ones(len(first)), skeleton)
    return HeadingFrame(first[skeleton.root] * [1.0, 0.0, 1.0], np.nan_to_num(yaw))
