"""Where the floor is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import linregress

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.retarget.runs import runs

from .contacts import ankles_and_toes

_LEAST_STANCES = 5  # that show a slope
_WALKED = 1.0  # m, in depth
_TIMES_ITS_ERROR = 3.0  # that a slope must be
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


def sensor_tilt(
    positions: Array, trust: Array, stands: NDArray[np.bool_], body: Body
) -> float:
    """Return how far the floor rises away from the sensor, 0 where that is unknown.

    Sensors give positions in their own frame, and most look down a little. Where the
    feet of somebody who walks stand at different depths, a straight line through their
    heights says by how much; it counts if people walked a meter or more, and if it is
    three times as steep as its error.

    Args:
        positions: Joint positions [m], y up in the sensor's frame, shape (T, J, 3).
        trust: Share of the measurement in each joint, shape (T, J).
        stands: Whether each foot stands, shape (T, 2).
        body: Whose ankles they are.

    Returns:
        Angle [rad] about x, to give to ``leveled``.
    """
    ankles, _ = ankles_and_toes(body.skeleton)
    places = []
    for foot, ankle in enumerate(ankles):
        for stance in runs(stands[:, foot]):
            seen = positions[stance, ankle][trust[stance, ankle] >= 0.5]
            if len(seen) > 0:
                places.append(np.median(seen, axis=0))
    if len(places) < _LEAST_STANCES:
        return 0.0
    _, height, depth = np.transpose(places)
    if np.ptp(depth) < _WALKED:
        return 0.0
    line = linregress(depth, height)
    sure = abs(line.slope) > _TIMES_ITS_ERROR * line.stderr
    return float(np.arctan(line.slope)) if sure else 0.0


def leveled(positions: Array, tilt: float) -> Array:
    """Return positions (..., 3) turned about the sensor so that the floor is level."""
    if tilt == 0.0:
        return positions
    turned = positions.copy()
    y, z = positions[..., 1], positions[..., 2]
    turned[..., 1] = np.cos(tilt) * y - np.sin(tilt) * z
    turned[..., 2] = np.sin(tilt) * y + np.cos(tilt) * z
    return turned


def to_world(positions: Array, tilt: float, floor: float) -> Array:
    """Return what a sensor measured in the world frame, level and the floor at y = 0.

    Args:
        positions: Points [m], sensor frame, shape (..., 3).
        tilt: Angle [rad], as for ``leveled``.
        floor: Height of the floor [m] once they are leveled.
    """
    return leveled(positions, tilt) - [0.0, floor, 0.0]


def put_on_floor(positions: Array, body: Body) -> Array:
    """Return positions (T, J, 3) with no capsule that ends at a joint under y = 0."""
    skeleton = body.skeleton
    clearance = body.radii.copy()
    np.maximum.at(clearance, skeleton.segment_parents, body.radii[skeleton.segments])
    lifted = positions.copy()
    np.maximum(lifted[..., 1], clearance, out=lifted[..., 1])
    return lifted
