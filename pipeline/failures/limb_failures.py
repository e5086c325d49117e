"""Limbs in impossible postures, and limbs that jump from one place to another."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import median_filter

from kinefilter.characters import State, Take
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.rotations import unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.reliability import column_medians

_BACKWARDS = 0.06
"""Share of a leg's length by which the knee lies behind the line from hip to ankle: 14
degrees of hyperextension, three times what is normal."""
_FORWARD = 0.5
"""Sine of the angle by which a shank is bent forward from its thigh: 30 degrees. In
mocap of six people it is 0.21 at most. Chosen, with the time around it, on s02, s03 and
s04 of UI-PRMD, who have such legs in 12 of 568 clips."""
_AROUND = 0.2  # s before and after such a frame, in which the leg is on its way
_CLEARANCE = 0.12
"""Distance [m] between the center lines of forearm and head at which they touch: half
the breadth of a head, 15 cm, plus the radius of a forearm, 4.5 cm, rounded. In recorded
arms that mocap agrees with it is 16 cm or more, in lost ones less than 11."""
_FOREARM = 0.75  # share of it, from the elbow, that is judged: hands may touch the head
_OVER_HEAD = 0.17
"""Height [m] of a wrist above the middle of the head from which a forearm whose elbow
is at most _CLEARANCE below that middle passes over the crown, not through the head. In
recorded failures it is 13 cm at most."""
_RAISED = np.cos(np.radians(40.0))
"""Cosine of the angle to straight up within which an arm is above the trunk, where
elbows may meet. Recorded arms out of range have 0.74 at most."""
_ADDUCTION = np.radians(135.0)
"""How far an arm reaches across the chest [rad], 0 to the side and a quarter turn to
the front: horizontal adduction, for which textbooks give 130 to 135 degrees."""
_TOLERANCE = np.radians(15.0)
"""How far out of its range an upper arm has to be [rad] to count: twice the maximum in
126 clips of mocap, except for one of 19 degrees whose arm goes through the trunk."""
_MEDIAN_TIME = 0.3  # s of the running median before a limb is judged
_LEAP = 0.6
"""How far a joint of a limb jumps, as a share of the segment that ends there: 35
degrees. The maximum in 126 clips of marker mocap, with punches and dances, is 0.5."""
_LEAP_TIME = 1.0 / 15.0
"""Time [s] too short for a movement from rest to rest: the fastest voluntary
contractions last about a tenth of a second, however small they are (Freund & Buedingen
1978, Experimental Brain Research 31:1-12)."""
_REST = 0.1  # s before and after a jump, in which a really quick limb is still moving
_SLACK = 1.25  # times _LEAP_TIME that two frames of an uneven clock may be apart
LIMBS = {"arm": ("Shoulder", "Elbow", "Wrist"), "leg": ("Hip", "Knee", "Ankle")}
"""Joints of a limb, from the trunk outwards."""


def bent_backwards(take: Take, side: str) -> Flags:
    """Return the frames in which a knee is bent far backwards, shape (T,)."""
    hip, knee, ankle = (_joint(take, part, side) for part in ("Hip", "Knee", "Ankle"))
    front = unit(np.cross(_across(take, "Hip"), _upward(take)))
    leg, thigh = ankle - hip, knee - hip
    along = np.sum(thigh * leg, axis=1) / np.maximum(np.sum(leg * leg, axis=1), 1e-9)
    ahead = np.sum((thigh - along[:, None] * leg) * front, axis=1)
    length = np.linalg.norm(thigh, axis=1) + np.linalg.norm(ankle - knee, axis=1)
    median = column_medians(length[:, None])
    share = np.nan_to_num(ahead / np.maximum(median, 1e-9))
    return np.asarray(_running_median(take, share) < -_BACKWARDS)


def folded_forward(take: Take, side: str) -> Flags:
    """Return the frames in which a shank is folded in front of its thigh, shape (T,).

    So it is where the sensor takes it for another limb. Frames just before and after
    count as well, as the leg is on its way. Legs that are nearly straight may kick.
    """
    hip, knee, ankle = (_joint(take, part, side) for part in ("Hip", "Knee", "Ankle"))
    thigh, shank = unit(knee - hip), unit(ankle - knee)
    front = np.cross(thigh, unit(_across(take, "Hip")))
    folded = (np.vecdot(shank, front) > _FORWARD) & (np.vecdot(shank, thigh) < 0.0)
    around = np.zeros(len(take), dtype=bool)
    for run in runs(folded):
        begin, end = take.time[[run.start, run.stop - 1]] + [-_AROUND, _AROUND]
        around |= (take.time >= begin) & (take.time <= end)
    return around


def through_head(take: Take, side: str) -> Flags:
    """Return the frames in which a forearm is inside the neck or head, shape (T,)."""
    elbow, wrist = _joint(take, "Elbow", side), _joint(take, "Wrist", side)
    neck, head = take.positions[:, take.skeleton.girdle], _joint(take, "Head")
    distances = _distances(elbow, _FOREARM * (wrist - elbow), neck, head)
    up = unit(_upward(take))
    elbow, wrist = (np.sum((end - head) * up, axis=1) for end in (elbow, wrist))
    over = (wrist > _OVER_HEAD) & (elbow > -_CLEARANCE)
    distances = np.nan_to_num(np.where(over, np.inf, distances), nan=np.inf)
    return np.asarray(_running_median(take, distances) < _CLEARANCE)


def out_of_range(take: Take, side: str) -> Flags:
    """Return the frames in which an upper arm goes through the trunk, shape (T,).

    Arms reach across the chest up to 135 degrees, and behind the back no farther than
    straight back. The sector in between is bounded by two half planes that meet in the
    axis of the trunk; the angle to the nearer one counts.
    """
    left, up, front = trunk_axes(take)
    arm = unit(_joint(take, "Elbow", side) - _joint(take, "Shoulder", side))
    inward = np.sum(arm * left, axis=1) * (-1.0 if side == "Left" else 1.0)
    ahead = np.sum(arm * front, axis=1)
    across = -np.cos(_ADDUCTION) * ahead - np.sin(_ADDUCTION) * inward
    lowered = np.sum(arm * up, axis=1) < _RAISED
    beyond = np.where(lowered, np.minimum(-across, inward), -1.0)
    beyond = _running_median(take, np.nan_to_num(beyond, nan=-1.0))
    return np.asarray(beyond > np.sin(_TOLERANCE))


def leaps(take: Take, side: str, limb: str) -> Flags:
    """Return the frames in which a limb, ``arm`` or ``leg``, jumps, shape (T,).

    A sensor that loses a limb leaves it where it was, or on something else, until it
    finds it again from one frame to the next.
    """
    frames = np.zeros(len(take), dtype=bool)
    lag, rest = round(_LEAP_TIME * take.fps), max(1, round(_REST * take.fps))
    # With a slow sensor, or dropped frames, a limb has the time to get there.
    if lag < 1 or len(take) < lag + 2 * rest + 1:
        return frames
    quick = take.time[lag:] - take.time[:-lag] <= _SLACK * _LEAP_TIME
    for start, end in pairwise(LIMBS[limb]):
        bones = {s: _joint(take, end, s) - _joint(take, start, s) for s in SIDES}
        lengths = np.stack([np.linalg.norm(b, axis=1) for b in bones.values()], axis=1)
        # The longer side's median is the true length, as lost limbs shrink.
        longest = max(np.nan_to_num(column_medians(lengths)).max(), 1e-3)
        far = _contrasts(bones[side] / longest, lag, rest) > _LEAP
        for k in range(lag + 1):
            frames[k : len(take) - lag + k] |= far & quick
    return frames


def _contrasts(bones: Array, lag: int, rest: int) -> Array:
    """Return movement over ``lag`` frames minus that around it, shape (T - lag,)."""
    moved = np.linalg.norm(bones[lag:] - bones[:-lag], axis=1)
    before, after = np.zeros((2, len(bones)))
    for k in range(1, rest + 1):
        step = np.linalg.norm(bones[k:] - bones[:-k], axis=1)
        before[k:] = np.maximum(before[k:], step)
        after[:-k] = np.maximum(after[:-k], step)
    contrasts = moved - before[:-lag] - after[lag:]
    # At the ends of the take it is unknown whether the person was at rest.
    contrasts[:rest] = contrasts[len(contrasts) - rest :] = 0.0
    return np.asarray(np.nan_to_num(contrasts))


def trunk_axes(take: Take) -> tuple[Array, Array, Array]:
    """Return unit vectors to the left, up the spine and to the front, each (T, 3)."""
    up = unit(_upward(take))
    front = unit(np.cross(_across(take, "Hip") + _across(take, "Shoulder"), up))
    return np.cross(up, front), up, front


def _upward(take: Take) -> Array:
    """Return the vector from the root to the middle of the shoulders [m], (T, 3)."""
    girdle = take.positions[:, take.skeleton.girdle]
    return np.asarray(girdle - take.positions[:, take.skeleton.root])


def _across(take: Take, part: str) -> Array:
    return _joint(take, part, "Left") - _joint(take, part, "Right")


def _joint(take: Take, part: str, side: str = "") -> Array:
    return take.positions[:, take.skeleton.index(f"{part}{side}")]


def _running_median(take: Take, values: Array) -> Array:
    rate = (len(take) - 1) / (take.time[-1] - take.time[0])
    width = max(1, round(_MEDIAN_TIME * rate))
    return np.asarray(median_filter(values, width, mode="nearest"))


def _distances(start: Array, way: Array, low: Array, high: Array) -> Array:
    """Return the distances [m] of segments (start, start + way) and (low, high), (T,).

    Ericson 2005, Real-Time Collision Detection, section 5.1.9: clipped nearest points.
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
    nearest = between + s[:, None] * way - t[:, None] * other
    return np.asarray(np.linalg.norm(nearest, axis=1))


_RARELY, _MOSTLY = 0.3, 0.5  # shares of the frames. Guesses.


def guessed_knees(take: Take) -> Flags:
    """Return True for guesses of knees that are rarely tracked, unlike the leg, (T, J).

    So are knees behind a desk: a Kinect guesses legs that hang, also of people who sit;
    where knees are follows better from the rest of the body. Where a whole leg is
    guessed, the sensor's guess is better than none.
    """
    tracked = take.state == State.TRACKED
    share, guessed = tracked.mean(axis=0), np.zeros_like(tracked)
    for side in SIDES:
        hip, knee, ankle = (take.skeleton.index(part + side) for part in LIMBS["leg"])
        if share[knee] <= _RARELY and min(share[[hip, ankle]]) > _MOSTLY:
            guessed[:, knee] = ~tracked[:, knee]
    return np.asarray(guessed)
