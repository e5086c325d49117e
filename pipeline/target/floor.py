"""Where the floor is, and where a take begins in a scene.

Joint positions [m] have y up and shape (T, J, 3); the confidence of joints has shape
(T, J); whether each foot stands has shape (T, 2), left and right.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Clip, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.retarget import HeadingFrame, find_yaw

from .feet import ankles_and_toes

_FIRST_FRAMES = 15  # half a second, in which people do not walk far
_LEAST_STANCES = 5  # that show a slope
_WALKED = 1.0  # m, in depth
_TIMES_ITS_ERROR = 3.0  # that a slope must be
_STANDING = 10.0
"""Percentile of the lowest sole that is taken for standing: above the frames in which
the tracker lets a foot sink."""
_DEEPEST = 0.01
"""m under the floor that contact lets soles sink where a take is good."""


def floor_height(
    positions: Array, confidence: Array, stands: Flags, body: Body
) -> float:
    """Return the height [m] of the floor under a take.

    The median over all feet that stand, by how high their ankles are over the floor.
    Where none does, the lower sole of each frame, at the height it has on the body when
    standing, and of all frames the 10th percentile. Joints that were measured count;
    where no foot ever was, the lowest joint of the body serves.
    """
    heights = positions[..., 1] - body.rest_positions[:, 1]
    ankles, toes = ankles_and_toes(body.skeleton)
    feet = ankles + toes
    standing = heights[:, ankles][stands & (confidence[:, ankles] >= 0.5)]
    standing = standing[~np.isnan(standing)]
    if len(standing) > 0:
        return float(np.median(standing))
    seen = np.where(confidence[:, feet] >= 0.5, heights[:, feet], np.nan)
    frames = ~np.isnan(seen).all(axis=1)
    if frames.any():
        return float(np.percentile(np.nanmin(seen[frames], axis=1), _STANDING))
    return float((positions[..., 1] - body.radii).min())


def sensor_tilt(
    positions: Array, confidence: Array, stands: Flags, body: Body
) -> float:
    """Return the angle [rad] about x that levels the floor, 0 where it is unknown.

    Sensors give positions in their own frame, and most look down a little. Where the
    feet of somebody who walks stand at different depths, a straight line through their
    heights says by how much; it counts if people walked a meter or more, and if it is
    three times as steep as its error. Positions are in the sensor's frame.
    """
    ankles, _ = ankles_and_toes(body.skeleton)
    places = []
    for foot, ankle in enumerate(ankles):
        for stance in runs(stands[:, foot]):
            seen = positions[stance, ankle][confidence[stance, ankle] >= 0.5]
            if len(seen) > 0:
                places.append(np.median(seen, axis=0))
    if len(places) < _LEAST_STANCES:
        return 0.0
    _, height, depth = np.transpose(places)
    if np.ptp(depth) < _WALKED:
        return 0.0
    from scipy.stats import linregress  # takes long to load, and few takes need it

    line = linregress(depth, height)
    sure = abs(line.slope) > _TIMES_ITS_ERROR * line.stderr
    return float(np.arctan(line.slope)) if sure else 0.0


def leveled(positions: Array, tilt: float, roll: float = 0.0) -> Array:
    """Return positions (..., 3) turned about the sensor so that the floor is level.

    First by the roll [rad] about z, from x to y, then by the tilt about x, from y to z.
    """
    for angle, a, b in ((roll, 0, 1), (tilt, 1, 2)):
        if angle != 0.0:
            one, other = positions[..., a], positions[..., b]
            positions = positions.copy()
            positions[..., a] = np.cos(angle) * one - np.sin(angle) * other
            positions[..., b] = np.sin(angle) * one + np.cos(angle) * other
    return positions


def to_world(positions: Array, tilt: float, floor: float, roll: float = 0.0) -> Array:
    """Return what a sensor measured [m] in the world frame, level, the floor at y = 0.

    The floor is the floor's height [m] once positions (..., 3) are leveled.
    """
    return leveled(positions, tilt, roll) - [0.0, floor, 0.0]


def in_world(take: Take, clip: Clip) -> Array:
    """Return the joint positions [m] of a clip's take in its world frame, (T, J, 3)."""
    return to_world(take.positions, clip.tilt, clip.floor, clip.roll)


def put_on_floor(positions: Array, body: Body) -> Array:
    """Return positions (T, J, 3) with no capsule that ends at a joint under y = 0."""
    lifted = positions.copy()
    np.maximum(lifted[..., 1], clearances(body), out=lifted[..., 1])
    return lifted


def clearances(body: Body) -> Array:
    """Return how high joints are where their capsules rest [m], (J,)."""
    skeleton, found = body.skeleton, body.radii.copy()
    np.maximum.at(found, skeleton.segment_parents, body.radii[skeleton.segments])
    return found


def sunk(heights: Array, clearance: Array) -> Array:
    """Return by how much [m] a body is deeper in the floor than contact lets it, (...).

    Joints at ``heights`` [m], shape (..., J), have their ``clearances``. Leaps of a
    tracker throw the character into the floor within a single step.
    """
    depth = (clearance - heights).max(axis=-1)
    return np.asarray(np.maximum(depth - _DEEPEST, 0.0))


def place_of(positions: Array, skeleton: Skeleton) -> HeadingFrame:
    """Return where a motion begins; its ``remove`` brings the motion into a scene.

    In a scene the person stands at the origin and faces +z (MuJoCo's +x). The floor is
    at y = 0.
    """
    first = np.median(positions[:_FIRST_FRAMES], axis=0)
    yaw = find_yaw(first, np.ones(len(first)), skeleton)
    return HeadingFrame(first[skeleton.root] * [1.0, 0.0, 1.0], np.nan_to_num(yaw))
