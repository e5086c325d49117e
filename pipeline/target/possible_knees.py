"""Keeps knees from bending backward, as legs of people seen from the side do."""

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.failures.limb_failures import LIMBS

# m by which a knee may be behind the line from hip to ankle: 9 degrees. Mocap of six
# people has 12 degrees at most. Chosen, as the rest, on walks of p00 to p08.
_BEHIND = 0.03
_SIDEWAYS, _UPRIGHT = 0.3, 0.7
"""Sines of a leg's angle to the line through the hips: which way knees of a leg face
that points along it is not known, and is known."""


def possible_knees(positions: Array, skeleton: Skeleton) -> Array:
    """Return joints [m] (T, J, 3) with knees that are hardly behind their leg."""
    moved = positions.copy()
    left_hip, right_hip = (positions[:, hip] for hip in skeleton.hips)
    left = unit(left_hip - right_hip)
    for side in SIDES:
        hip, knee, ankle = (skeleton.index(f"{p}{side}") for p in LIMBS["leg"])
        front = np.cross(unit(positions[:, ankle] - positions[:, hip]), left)
        sine = np.linalg.norm(front, axis=1)
        front = unit(front)
        ahead = np.vecdot(positions[:, knee] - positions[:, hip], front)
        known = ((sine - _SIDEWAYS) / (_UPRIGHT - _SIDEWAYS)).clip(0.0, 1.0)
        change = known * np.maximum(-_BEHIND - ahead, 0.0)
        moved[:, knee] += change[:, None] * front
    return moved
