"""Twist bones, which spread a limb's twist evenly along a segment.

The skin of an upper arm must not twist at the shoulder, but only toward the elbow, and
that of a forearm must twist with the hand at the wrist. So a twist bone turns about its
segment by a share of the twist.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import inverse, multiply


class Twist(NamedTuple):
    """What turns a twist bone."""

    limb: int
    """Index of the joint whose segment it is on."""
    joint: int
    """Index of the joint whose twist about that segment it shares."""
    above: int
    """Index of the turned joint against which that joint twists."""
    axis: Array
    """Direction of the segment in the rest pose, unit length, (3,)."""
    share: float
    """Share of the twist by which it is turned against the segment."""


def angle_about(axis: Array, rotations: Array) -> Array:
    """Return the twist [rad] of rotations, wxyz (..., 4), about a unit vector (3,).

    It lies between -pi and pi; the rest of the rotation is about a perpendicular axis.
    """
    half = np.arctan2(rotations[..., 1:] @ axis, rotations[..., 0])
    return np.asarray((2.0 * half + np.pi) % (2.0 * np.pi) - np.pi)


def twisted(
    twists: Mapping[int, Twist], turns: Mapping[int, Array]
) -> dict[int, Array]:
    """Return the rotation of each twist bone, given those of the other joints.

    Both are world rotations from the rest pose, wxyz, (T, 4), by index of the joint.
    """
    found = {}
    for bone, (limb, joint, above, axis, share) in twists.items():
        angle = angle_about(axis, multiply(inverse(turns[above]), turns[joint]))
        half = 0.5 * share * angle[:, None]
        turn = np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)
        found[bone] = multiply(turns[limb], turn)
    return found
