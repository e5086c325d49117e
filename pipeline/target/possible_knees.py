"""Keeps knees from bending backward, as legs of people seen from the side do."""

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.failures.limb_failures import LIMBS

# m by which a knee may be behind the line from hip to ankle: 9 degrees. Mocap of six
# people has 12 degrees at most. Chosen, as the rest, on walks of p00 to p08.
_BEHIND = 0.03
_SIDEWAYS, _UPRIGHT = 0.3, 0.7
"""Sines of a leg's angle to the line through the hips: which way knees of a leg face
that points along it is not known, and is known."""


def possible_knees(positions: Array, skeleton: Skeleton) -> Array:
    """Return joints [m] (T, J, 3) with knees that are hardly behind their leg."""
    hips, knees, ankles = (skeleton.sides(part) for part in LIMBS["leg"])
    top, moved = positions[:, hips], positions.copy()
    left = unit(top[:, :1] - top[:, 1:])
    front = cross(unit(positions[:, ankles] - top), left)
    sine = np.sqrt(np.vecdot(front, front))
    front = unit(front)
    ahead = np.vecdot(positions[:, knees] - top, front)
    known = ((sine - _SIDEWAYS) / (_UPRIGHT - _SIDEWAYS)).clip(0.0, 1.0)
    change = known * np.maximum(-_BEHIND - ahead, 0.0)
    moved[:, knees] += change[..., None] * front
    return moved
