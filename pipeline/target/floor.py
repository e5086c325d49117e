"""The floor: its height and slope, and the placement of a take in a scene.

Joint positions [m] have y up and shape (T, J, 3); confidence has shape (T, J);
``stands`` says whether each foot is planted, shape (T, 2), left and right.
"""

import numpy as np

from kinefilter.characters import Body, Clip, Skeleton, Take
from kinefilter.characters.anthropometry import joint_masses
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.retarget import HeadingFrame, find_yaw

from .feet import ankles_and_toes
from .upright import HANGING, posture_of

_FIRST_FRAMES = 15  # half a second, in which people do not walk far
_LEAST_STANCES = 5  # needed to measure a slope
_WALKED = 1.0  # m of depth that the stances have to span
_LEAST_RATIO = 3.0  # of a slope to its standard error
# By marker mocap of six people (UI-PRMD) who stand, the center of mass is 2.1 to 4.6
# degrees in front of the ankles. Limits were chosen on s02, s03 and s04, on p00 to p08
# of two-kinects, and on one take of p12, who stands beside the sensor.
_LEAN = np.radians(3.0)
# Smaller tilts may be the person's own lean; larger ones are found by ``upright``.
_LEAST_TILT, _MOST_TILT = np.radians([4.0, 15.0])
_LEAST_FRAMES = 15  # standing: half a second
_STEADY = np.radians(2.0)  # interquartile range of the lean in these frames
_FACING = np.cos(np.radians(25.0))  # from the side, sensors misplace the far limbs
_ASIDE = np.radians(3.0)  # people lean less to a side; else they face elsewhere
_STANDING = 10.0  # percentile of the lower soles that is the floor: a few sink below
_DEEPEST = 0.01  # m that contact lets soles sink into the floor in a good take


def floor_height(
    positions: Array, confidence: Array, stands: Flags, body: Body
) -> float:
    """Return the height [m] of the floor under a take.

    This is the median height of the ankles of planted feet, less their height at rest.
    If none is planted, the lower foot of each frame counts, and the 10th percentile.
    Only measured joints count; if no foot ever was, the body's lowest point does.
    """
    heights = positions[..., 1] - body.rest_positions[:, 1]
    ankles, toes = ankles_and_toes(body.skeleton)
    planted = heights[:, ankles][stands & (confidence[:, ankles] >= 0.5)]
    planted = planted[~np.isnan(planted)]
    if len(planted) > 0:
        return float(np.median(planted))
    heights, confidence = heights[:, ankles + toes], confidence[:, ankles + toes]
    seen = np.where(confidence >= 0.5, heights, np.nan)
    frames = ~np.isnan(seen).all(axis=1)
    if frames.any():
        return float(np.percentile(np.nanmin(seen[frames], axis=1), _STANDING))
    return float((positions[..., 1] - body.radii).min())


def sensor_tilt(
    positions: Array,
    confidence: Array,
    stands: Flags,
    body: Body,
    *,
    by_kinect: bool = True,
) -> float:
    """Return the angle [rad] about x that levels the floor, 0 if it is unknown.

    Positions are in the frame of the sensor, and most sensors look down a little. The
    slope of a line through the heights of planted feet over their depths is the tilt,
    if the feet span a meter or more of depth and the slope is three times its error.
    If they span less, people who stand still before a Kinect show it: they would fall
    if they were not upright.
    """
    ankles, _ = ankles_and_toes(body.skeleton)
    places = []
    for foot, ankle in enumerate(ankles):
        for stance in runs(stands[:, foot]):
            seen = positions[stance, ankle][confidence[stance, ankle] >= 0.5]
            if len(seen) > 0:
                places.append(np.median(seen, axis=0))
    _, height, depth = np.reshape(places, (-1, 3)).T
    if len(places) < _LEAST_STANCES or np.ptp(depth) < _WALKED:
        if not by_kinect:
            return 0.0
        return _tilt_by_balance(positions, confidence, stands, body)
    from scipy.stats import linregress  # slow to import, and few takes need it

    line = linregress(depth, height)
    significant = abs(line.slope) > _LEAST_RATIO * line.stderr
    return float(np.arctan(line.slope)) if significant else 0.0


def _tilt_by_balance(
    positions: Array, confidence: Array, stands: Flags, body: Body
) -> float:
    """Return the angle [rad] about x that balances people who stand before the sensor.

    Their arms hang, and they face it. 0 if there are too few such frames, or if the
    tilt may be the person's own lean.
    """
    skeleton, masses = body.skeleton, joint_masses(body)
    (ankles, _), root = ankles_and_toes(skeleton), positions[:, skeleton.root]
    _, straight, down = posture_of(positions, skeleton)
    upright = straight.all(axis=1) & (down > HANGING).all(axis=1)
    yaw = find_yaw(positions, np.ones(confidence.shape), skeleton)
    facing = np.cos(yaw - np.arctan2(-root[:, 0], -root[:, 2])) > _FACING
    seen = (confidence[:, ankles] >= 0.5).all(axis=1)
    frames = np.flatnonzero(stands.all(axis=1) & seen & facing & upright)
    if len(frames) < _LEAST_FRAMES:
        return 0.0
    center = np.einsum("j,tji->ti", masses / masses.sum(), positions[frames])
    across, up, deep = (center - positions[frames][:, ankles].mean(axis=1)).T
    tilts = _LEAN * np.cos(yaw[frames]) - np.arctan2(deep, up)
    least, tilt, most = np.percentile(tilts, [25.0, 50.0, 75.0])
    aside = np.median(np.arctan2(across, up))
    sure = most - least < _STEADY and abs(aside) < _ASIDE
    return float(tilt) if sure and _LEAST_TILT < abs(tilt) < _MOST_TILT else 0.0


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


def floor_penetration(heights: Array, clearance: Array) -> Array:
    """Return the depth [m] of a body in the floor beyond what contact allows, (...).

    Heights [m] of joints, shape (..., J), are compared with their ``clearances``. A
    jump of the tracker can throw the character into the floor within a single step.
    """
    depth = (clearance - heights).max(axis=-1)
    return np.asarray(np.maximum(depth - _DEEPEST, 0.0))


def find_placement(positions: Array, skeleton: Skeleton) -> HeadingFrame:
    """Return the frame in which a motion begins; ``remove`` it to place it in a scene.

    There the person starts at the origin and faces +z (MuJoCo's +x), the floor at 0.
    """
    first = np.median(positions[:_FIRST_FRAMES], axis=0)
    yaw = find_yaw(first, np.ones(len(first)), skeleton)
    return HeadingFrame(first[skeleton.root] * [1.0, 0.0, 1.0], np.nan_to_num(yaw))
