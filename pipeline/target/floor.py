"""The floor: its height, and the placement of a take in a scene.

Joint positions [m] have y up and shape (T, J, 3); confidence has shape (T, J);
``stands`` says whether each foot is planted, shape (T, 2), left and right.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Body, Clip, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.retarget import HeadingFrame, find_yaw

from .feet import ankles_and_toes

_FIRST_FRAMES = 15  # half a second, in which people do not walk far
_STANDING = 10.0  # percentile of the lower soles that is the floor: a few sink below
_DEEPEST = 0.01  # m that contact lets soles sink into the floor in a good take


class Stood(NamedTuple):
    """Where a person stood: joints and planted feet, in the frame of the sensor."""

    positions: Array
    confidence: Array
    stands: Flags
    body: Body


def floor_heights(people: Sequence[Stood]) -> list[float]:
    """Return the height [m] of the floor under each person of a recording.

    This is the median height of the ankles of planted feet, less their height at rest.
    Those who never planted a foot stand on the floor of the others: their median. If
    nobody did, the lower foot of each frame counts, and the 10th percentile. Only
    measured joints count; if no foot ever was, the body's lowest point does.
    """
    planted = [_planted_height(person) for person in people]
    known = [height for height in planted if height is not None]
    if known:
        return [float(np.median(known)) if h is None else h for h in planted]
    return [_lowest(person) for person in people]


def _planted_height(person: Stood) -> float | None:
    ankles, _ = ankles_and_toes(person.body.skeleton)
    heights = person.positions[:, ankles, 1] - person.body.rest_positions[ankles, 1]
    planted = heights[person.stands & (person.confidence[:, ankles] >= 0.5)]
    planted = planted[~np.isnan(planted)]
    return float(np.median(planted)) if len(planted) else None


def _lowest(person: Stood) -> float:
    positions, confidence, _, body = person
    ankles, toes = ankles_and_toes(body.skeleton)
    feet = ankles + toes
    heights = positions[:, feet, 1] - body.rest_positions[feet, 1]
    seen = np.where(confidence[:, feet] >= 0.5, heights, np.nan)
    frames = ~np.isnan(seen).all(axis=1)
    if frames.any():
        return float(np.percentile(np.nanmin(seen[frames], axis=1), _STANDING))
    return float((positions[..., 1] - body.radii).min())


def leveled(positions: Array, tilt: float, roll: float = 0.0) -> Array:
    """Return positions (..., 3) rotated about the sensor so that the floor is level.

    The roll [rad] about z, from x to y, comes first, then the tilt about x, y to z.
    """
    for angle, a, b in ((roll, 0, 1), (tilt, 1, 2)):
        if angle != 0.0:
            one, other = positions[..., a], positions[..., b]
            positions = positions.copy()
            positions[..., a] = np.cos(angle) * one - np.sin(angle) * other
            positions[..., b] = np.sin(angle) * one + np.cos(angle) * other
    return positions


def to_world(positions: Array, tilt: float, floor: float, roll: float = 0.0) -> Array:
    """Return a sensor's positions [m], (..., 3), in the world frame, floor at y = 0.

    ``floor`` is the height of the floor [m] after leveling.
    """
    return leveled(positions, tilt, roll) - [0.0, floor, 0.0]


def in_world(take: Take, clip: Clip) -> Array:
    """Return the joint positions [m] of a clip's take in its world frame, (T, J, 3)."""
    return to_world(take.positions, clip.tilt, clip.floor, clip.roll)


def put_on_floor(positions: Array, body: Body) -> Array:
    """Return positions (T, J, 3) raised until no capsule end is below y = 0."""
    lifted = positions.copy()
    np.maximum(lifted[..., 1], clearances(body), out=lifted[..., 1])
    return lifted


def clearances(body: Body) -> Array:
    """Return the height [m] of each joint when its capsules rest on the floor, (J,)."""
    skeleton, found = body.skeleton, body.radii.copy()
    np.maximum.at(found, skeleton.segment_parents, body.radii[skeleton.segments])
    return found


def floor_penetration(
    heights: Array, clearance: Array, allowed: float = _DEEPEST
) -> Array:
    """Return the depth [m] of a body in the floor beyond what is allowed [m], (...).

    Heights [m] of joints, shape (..., J), are compared with their ``clearances``. A
    jump of the tracker can throw the character into the floor within a single step.
    """
    depth = (clearance - heights).max(axis=-1)
    return np.asarray(np.maximum(depth - allowed, 0.0))


def find_placement(positions: Array, skeleton: Skeleton) -> HeadingFrame:
    """Return the frame in which a motion begins; ``remove`` it to place it in a scene.

    There the person starts at the origin and faces +z (MuJoCo's +x), the floor at 0.
    """
    first = np.median(positions[:_FIRST_FRAMES], axis=0)
    yaw = find_yaw(first, skeleton)
    return HeadingFrame(first[skeleton.root] * [1.0, 0.0, 1.0], np.nan_to_num(yaw))
