"""Limbs where no joint lets them go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability.shum import column_medians

from .trunk import trunk_axes, unit, upward

_BACKWARDS = 0.06
"""Share of a leg's length by which a knee is behind the line from hip to ankle: 14
degrees of hyperextension, three times what is normal."""
_CLEARANCE = 0.12
"""Distance of the middle lines of forearm and head [m] at which they touch: half the
breadth of a head, 15 cm, and the radius of a forearm, 4.5 cm; both rounded. Recorded
arms that mocap agrees with keep 16 cm, lost ones come nearer than 11."""
_FOREARM = 0.75
"""Share of the forearm, from the elbow, that is judged: the hand may be anywhere on
the head or behind it, and the sensor places wrists no better than to some cm."""
_ADDUCTION = np.radians(135.0)
"""How far an arm goes across the chest [rad], 0 to the side, a quarter turn to the
front: horizontal adduction, for which textbooks give 130 to 135 degrees."""
_TOLERANCE = np.radians(15.0)
"""How far out of its range an upper arm has to be [rad], for the sensor's errors: twice
what 126 clips of marker mocap hold, but for one of 19 degrees, whose arm goes through
the trunk."""
_STEADY = 0.3  # s, of the median over time before a limb is judged


def bent_backwards(take: Take, side: str) -> NDArray[np.bool_]:
    """Return the frames in which a knee is far behind its leg, shape (T,)."""
    hip, knee, ankle = (_joint(take, part, side) for part in ("Hip", "Knee", "Ankle"))
    hips = _joint(take, "Hip", "Left") - _joint(take, "Hip", "Right")
    front = unit(np.cross(hips, upward(take)))
    leg, thigh = ankle - hip, knee - hip
    squares = np.maximum(np.sum(leg * leg, axis=1), 1e-9)
    along = np.sum(thigh * leg, axis=1) / squares
    ahead = np.sum((thigh - along[:, None] * leg) * front, axis=1)
    length = np.linalg.norm(thigh, axis=1) + np.linalg.norm(ankle - knee, axis=1)
    median = column_medians(length[:, None])
    share = np.nan_to_num(ahead / np.maximum(median, 1e-9))
    return np.asarray(_steady(take, share) < -_BACKWARDS)


def through_head(take: Take, side: str) -> NDArray[np.bool_]:
    """Return the frames in which a forearm is inside the neck or head, shape (T,).

    Sensors lose an arm behind the head or beyond it, and then see one in the head.
    """
    skeleton = take.skeleton
    elbow, wrist = _joint(take, "Elbow", side), _joint(take, "Wrist", side)
    neck = take.positions[:, skeleton.girdle]
    head = take.positions[:, skeleton.index("Head")]
    apart = _distances(elbow, _FOREARM * (wrist - elbow), neck, head)
    apart = np.nan_to_num(apart, nan=np.inf)
    return np.asarray(_steady(take, apart) < _CLEARANCE)


def out_of_range(take: Take, side: str) -> NDArray[np.bool_]:
    """Return the frames in which an upper arm goes through the trunk, shape (T,).

    Arms go across the chest, but no farther than to 135 degrees, and behind the back no
    farther than straight back. What lies between is shut by two half planes that meet
    in the trunk's axis; counted is the angle to the nearer one.
    """
    left, _, front = trunk_axes(take)
    arm = unit(_joint(take, "Elbow", side) - _joint(take, "Shoulder", side))
    inward = np.sum(arm * left, axis=1) * (-1.0 if side == "Left" else 1.0)
    ahead = np.sum(arm * front, axis=1)
    across = -np.cos(_ADDUCTION) * ahead - np.sin(_ADDUCTION) * inward
    beyond = np.nan_to_num(np.minimum(-across, inward), nan=-1.0)
    return np.asarray(_steady(take, beyond) > np.sin(_TOLERANCE))


def _joint(take: Take, part: str, side: str) -> Array:
    return take.positions[:, take.skeleton.index(f"{part}{side}")]


def _steady(take: Take, values: Array) -> Array:
    """Return medians over time, so that a frame or two decide nothing, (T,)."""
    rate = (len(take) - 1) / (take.time[-1] - take.time[0])
    width = max(1, round(_STEADY * rate))
    return np.asarray(median_filter(values, width, mode="nearest"))


def _distances(start: Array, way: Array, low: Array, high: Array) -> Array:
    """Return the distances of the segments start + way and low to high [m], (T,).

    After Ericson 2005, Real-Time Collision Detection, section 5.1.9: the nearest points
    of the lines, each then clipped to its segment.
    """
    other, between = high - low, start - low
    a = np.maximum(np.sum(way * way, axis=1), 1e-12)
    b = np.sum(way * other, axis=1)
    c = np.sum(way * between, axis=1)
    e = np.maximum(np.sum(other * other, axis=1), 1e-12)
    f = np.sum(other * between, axis=1)
    s = np.clip((b * f - c * e) / np.maximum(a * e - b * b, 1e-12), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    apart = between + s[:, None] * way - t[:, None] * other
    return np.asarray(np.linalg.norm(apart, axis=1))
