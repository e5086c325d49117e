"""The floor: its height and slope, and the placement of a take in a scene.

Joint positions [m] have y up and shape (T, J, 3); confidence has shape (T, J);
``stands`` says whether each foot is planted, shape (T, 2), left and right.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Body, Clip, Skeleton, Take
from kinefilter.characters.anthropometry import joint_masses
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.pipeline.upright import HANGING, posture_of
from kinefilter.retarget import HeadingFrame, find_yaw

from .feet import ankles_and_toes

_FIRST_FRAMES = 15  # half a second, in which people do not walk far
_LEAST_STANCES = 5  # needed to measure a slope
_WALKED = 1.0  # m of depth that the stances have to span
_LEAST_RATIO = 3.0  # of a slope to its standard error
# By marker mocap of six people (UI-PRMD) who stand, the center of mass is 2.1 to 4.6
# degrees in front of the ankles. Limits were chosen on s02, s03 and s04, on p00 to p08
# of two-kinects, and on one take of p12, who stands beside the sensor.
_LEAN = np.radians(3.0)
# Tilts that may be the person's own lean, and that cannot: of people who lean forward,
# and of those who do not, like scripted ones who balance on their ankles. What is
# between counts in part. Guesses.
_FORWARD, _BACK = np.radians([[1.0, 3.0], [3.75, 4.25]])
_MOST_TILT = np.radians(15.0)  # what is more is found by ``upright``
_LEAST_FRAMES = 15  # standing: half a second
_STEADY = np.radians(2.0)  # interquartile range of the lean in these frames
_FACING = np.cos(np.radians(25.0))  # from the side, sensors misplace the far limbs
_ASIDE = np.radians(3.0)  # people lean less to a side; else they face elsewhere
_STANDING = 10.0  # percentile of the lower soles that is the floor: a few sink below
_DEEPEST = 0.01  # m that contact lets soles sink into the floor in a good take


class Stood(NamedTuple):
    """Where a person stood: joints and planted feet, in the frame of the sensor."""

    positions: Array
    confidence: Array
    stands: Flags
    body: Body

    def places(self) -> Array:
        """Return the median place [m] of each planted foot while it stood, (N, 3)."""
        places = []
        for foot, ankle in enumerate(ankles_and_toes(self.body.skeleton)[0]):
            for stance in runs(self.stands[:, foot]):
                sure = self.confidence[stance, ankle] >= 0.5
                if sure.any():
                    seen = self.positions[stance, ankle][sure]
                    places.append(np.median(seen, axis=0))
        return np.reshape(places, (-1, 3))


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


def sensor_tilt(people: Sequence[Stood], *, by_kinect: bool = True) -> float:
    """Return the angle [rad] about x that levels the floor, 0 if it is unknown.

    Most sensors look down a little. The slope of a line through the heights of planted
    feet over their depths is the tilt, if the feet span a meter or more of depth and
    the slope is three times its error. Lines through the feet of several people of a
    recording are parallel: the sensor misplaces each person's feet by a height of their
    own. If the feet span less, people who stand still before a Kinect show the tilt:
    they would fall if they were not upright.
    """
    each = [person.places() for person in people]
    each = [places for places in each if len(places)]
    # On the first person's line, so that one line fits all.
    alike = [places - (places.mean(axis=0) - each[0].mean(axis=0)) for places in each]
    _, height, depth = np.reshape([p for some in alike for p in some], (-1, 3)).T
    free = len(depth) - 1 - len(each)
    if len(depth) < _LEAST_STANCES or free < 1 or np.ptp(depth) < _WALKED:
        return _tilt_by_balance(people) if by_kinect else 0.0
    from scipy.stats import linregress  # slow to import, and few takes need it

    line = linregress(depth, height)
    error = line.stderr * np.sqrt((len(depth) - 2) / free)
    significant = abs(line.slope) > _LEAST_RATIO * error
    return float(np.arctan(line.slope)) if significant else 0.0


def _tilt_by_balance(people: Sequence[Stood]) -> float:
    """Return the angle [rad] about x that balances people who stand before the sensor.

    Their arms hang, and they face it. 0 if there are too few such frames; less if it
    may be the people's own lean.
    """
    tilts, aside = np.concatenate([_leans(person) for person in people], axis=1)
    if len(tilts) < _LEAST_FRAMES:
        return 0.0
    least, tilt, most = np.percentile(tilts, [25.0, 50.0, 75.0])
    sure = most - least < _STEADY and abs(np.median(aside)) < _ASIDE
    own, other = _FORWARD if tilt < 0.0 else _BACK
    share = np.clip((abs(tilt) - own) / (other - own), 0.0, 1.0)
    return float(share * tilt) if sure and abs(tilt) < _MOST_TILT else 0.0


def _leans(person: Stood) -> Array:
    """Return angles [rad] that balance a person about x and z, shape (2, N).

    N are the frames in which they stand upright on both feet and face the sensor.
    """
    positions, confidence, stands, body = person
    skeleton, masses = body.skeleton, joint_masses(body)
    (ankles, _), root = ankles_and_toes(skeleton), positions[:, skeleton.root]
    _, straight, down = posture_of(positions, skeleton)
    upright = straight.all(axis=1) & (down > HANGING).all(axis=1)
    yaw = find_yaw(positions, skeleton)
    facing = np.cos(yaw - np.arctan2(-root[:, 0], -root[:, 2])) > _FACING
    seen = (confidence[:, ankles] >= 0.5).all(axis=1)
    frames = np.flatnonzero(stands.all(axis=1) & seen & facing & upright)
    center = np.einsum("j,tji->ti", masses / masses.sum(), positions[frames])
    across, up, deep = (center - positions[frames][:, ankles].mean(axis=1)).T
    tilts = _LEAN * np.cos(yaw[frames]) - np.arctan2(deep, up)
    return np.array([tilts, np.arctan2(across, up)])


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
