"""Where a Kinect v2 puts joints by definition: constant offsets, steadiness, kinship.

A tracker's joints are not the joint centers of anatomy. How far they are off turns
with the segments that meet at the joint, so that each offset has two parts, one fixed
to the segment that ends at the joint and one to the segment that starts there.

The numbers are facts about the sensor, fitted by ``tests/calibrate_kinect.py`` to a
Kinect v2 beside marker mocap (UI-PRMD, Vakanski et al. 2018, Data 3(1)), people s02,
s03 and s04, left and right taken together.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

_SAME = {
    "SpineBase": "HipCenter",
    "SpineMid": "Spine",
    "SpineShoulder": "ShoulderCenter",
    "Neck": "ShoulderCenter",
    "HandTip": "Hand",
    "Thumb": "Hand",
}
"""Names of Kinect v2 in tables that have Kinect v1's. Neck, HandTip and Thumb are
guessed from the joint beside them."""

# Joint -> offset [cm] along the rest axes (left, up, forward) of the segment that ends
# at it, and of the one that starts there. Spine and Hand: their neighbors' mean.
_OFFSETS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "HipCenter": ((0.0, -2.3, -1.9), (0.0, -0.4, -1.9)),
    "Spine": ((0.0, -2.3, 0.0), (0.0, -1.1, -1.4)),
    "ShoulderCenter": ((0.0, -4.1, 0.6), (0.0, 2.4, -2.4)),
    "Head": ((0.0, -0.3, -2.0), (0.0, -0.3, -2.0)),
    "Shoulder": ((0.1, 1.6, 1.7), (1.5, -3.2, 0.1)),
    "Elbow": ((-2.6, -0.7, 0.9), (2.2, -2.4, 0.7)),
    "Wrist": ((-0.1, 0.3, -0.4), (-0.1, 0.3, -0.4)),
    "Hand": ((-0.1, 0.3, -0.4), (-0.1, 0.3, -0.4)),
    "Hip": ((-1.9, -2.1, -0.2), (-0.3, 0.2, -0.7)),
    "Knee": ((0.1, 3.2, 1.7), (0.2, -0.1, -1.1)),
    "Ankle": ((0.8, 4.8, -0.5), (-0.2, 1.7, 0.8)),
    "Foot": ((-0.2, 1.6, -1.8), (-0.2, 1.6, -1.8)),
}

# Joint -> its moving error against the mean of all joints, and the correlation of this
# error with that of the joint's parent. Spine and Hand are guesses between neighbors.
# The first number is the fitted one, changed by hand where the sum of all errors was
# off: feet move least and would wobble too little, elbows move with their offsets too.
_MOVING: dict[str, tuple[float, float]] = {
    "HipCenter": (0.8, 0.0),
    "Spine": (0.7, 0.6),
    "ShoulderCenter": (0.56, 0.6),
    "Head": (0.6, 0.64),
    "Shoulder": (0.66, 0.35),
    "Elbow": (0.82, 0.35),
    "Wrist": (0.95, 0.51),
    "Hand": (1.1, 0.7),
    "Hip": (0.75, 0.88),
    "Knee": (1.0, 0.08),
    "Ankle": (1.6, 0.33),
    "Foot": (2.2, 0.78),
}


def _stem(joint: str) -> str:
    stem = joint.removesuffix("Left").removesuffix("Right")
    return _SAME.get(stem, stem)


def misplacements(skeleton: Skeleton) -> Array:
    """Return constant offsets [m] in the frames of segments, shape (2, J, 3).

    First the part that turns with the segment that ends at the joint, then the part
    that turns with the segment that starts there; T-pose, facing +z.
    """
    table = np.array([_OFFSETS[_stem(joint)] for joint in skeleton.joints])
    for j, joint in enumerate(skeleton.joints):
        if joint.endswith("Right"):
            table[j, :, 0] *= -1.0
    return np.asarray(0.01 * table.swapaxes(0, 1))


def unsteadiness(skeleton: Skeleton) -> Array:
    """Return each joint's moving error against the mean joint's, shape (J,)."""
    return np.array([_MOVING[_stem(joint)][0] for joint in skeleton.joints])


def kinship(skeleton: Skeleton) -> Array:
    """Return the matrix that makes independent errors those of one body, (J, J).

    Errors of unit variance keep it, and correlate with those of the parent.
    """
    mix = np.eye(len(skeleton))
    for j in skeleton.segments:
        shared = _MOVING[_stem(skeleton.joints[j])][1]
        mix[j] = shared * mix[skeleton.parents[j]]
        mix[j, j] = np.sqrt(1.0 - shared**2)
    return mix
