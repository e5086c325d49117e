"""The vertical of a take, from how the person stands.

A person who stands on straight legs under a straight trunk is upright to within a few
degrees, or they would fall. If that line is far from the vertical in most of a take,
the sensor was turned. Takes of people on the floor, on their hands or bent over are
left as they are: a straight body that lies shows nothing, so at least one arm has to
hang along the body, which it does not where the arms carry the person.
"""

from dataclasses import dataclass, replace

import numpy as np

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import unit

_STRAIGHT = np.cos(np.radians(30.0))
"""Cosine of the largest angle between shank, thigh and trunk in standing. A guess."""
_HANGING = 0.8  # share of its length that a hanging arm reaches down. A guess.
_ORDINARY = {"both": np.radians(15.0), "either": np.radians(20.0)}
"""Angle to the vertical [rad] up to which nothing is done, if both legs or at least one
are straight often enough. With sensors as people set them up, 1,254 clips of 20 people
have at most 10.4 and 15.0 degrees; marker mocap, including dances, 2.9 and 15.5."""
_TILTED, _OVER = np.radians([60.0, 135.0])  # between these a person may be lying
_MIN_SHARE = 0.25  # of all frames standing straight. Dancers pose in 0.2
_MIN_FRAMES = 15  # standing straight: half a second
# In this share of these frames the body is within 20 degrees of their median. Guesses.
_SIMILAR, _AGREEMENT = np.cos(np.radians(20.0)), 0.8
_HANGS = 0.1  # share of them with a hanging arm: 1,000 of the clips above have more
_CARRYING = -0.3
"""The reach of an arm in a handstand or headstand is lower: hands on the floor are as
far from the shoulders as the head. A guess."""
_LEANING = np.radians(30.0)  # of all frames, whatever people do; at most 25 in clips
_BACKWARDS = -0.25  # median cosine between toes and front; 0.26 or more in these clips
NEAREST = 0.5  # m: no sensor sees people who are nearer
_MIRRORED = (
    "toes point backwards in most frames: left and right are swapped, or an axis "
    "points the wrong way; if y points down, negate it"
)
_DOUBT = (
    "the person is {:.0f} degrees off the vertical in most frames, and the take does "
    "not show whether they really are or the sensor was turned; if it was, {}"
)
_ROTATE = "rotate the frames so that y points up"
_FRAMES = 5000  # to look at: enough for medians


@dataclass(frozen=True)
class Turn:
    """Rotation of a sensor's frame that makes the person stand upright."""

    roll: float = 0.0  # angle about z [rad], applied first; see ``leveled``
    tilt: float = 0.0  # angle about x [rad], applied second
    doubt: str = ""  # warning that the frame may be wrong, although left as it is

    def notes(self, tilt: float = 0.0, roll: float = 0.0) -> tuple[str, ...]:
        """Return notes for the user; the frame was also leveled by two angles [rad]."""
        tilt, notes = np.degrees(self.tilt + tilt), [self.doubt] * bool(self.doubt)
        if self.roll:
            what = "upside down" if abs(self.roll) > np.pi / 2.0 else "tilted"
            then = f", then by {tilt:+.1f} about x" if tilt else ""
            turned = f"{np.degrees(self.roll):+.1f} degrees about z{then}"
            note = f"the sensor was {what}, judging by how the person stands; "
            notes.insert(0, f"{note}frames were rotated by {turned}")
        else:
            angles = (("tilted", tilt), ("rolled", np.degrees(roll)))
            found = [
                f"{what} by {by:+.1f} degrees" for what, by in angles if round(by, 1)
            ]
            if found:
                notes.insert(0, f"the sensor was {' and '.join(found)}")
        return tuple(notes)


def given_turn(tilt: float) -> Turn:
    """Return the turn by a tilt that the user gives [degrees]; none if it is ordinary.

    Correction was learned with ordinary tilts, which are leveled after it.
    """
    angle = float(np.radians(tilt))
    return Turn(tilt=angle) if abs(angle) > _ORDINARY["both"] else Turn()


def find_turn(positions: Array, skeleton: Skeleton, least: int = _MIN_FRAMES) -> Turn:
    """Return the turn of a take; none if the take is ordinary or the turn uncertain.

    Joint positions [m] are in the sensor's frame, y up, NaN where missing, shape
    (T, J, 3). The person has to stand straight in ``least`` frames or more.
    """
    positions = positions[:: 1 + len(positions) // _FRAMES]
    along, straight, down = _posture(positions, skeleton)
    if not len(along):
        return Turn()
    if _mirrored(positions, skeleton):
        return Turn(doubt=_MIRRORED)
    return _turn_from(along, straight, down, least)


def _turn_from(along: Array, straight: Flags, down: Array, least: int) -> Turn:
    """Return the turn for postures as ``_posture`` returns them."""
    enough = max(least, _MIN_SHARE * len(along))
    stands, ordinary = straight.all(axis=1), _ORDINARY["both"]
    if stands.sum() < enough:
        stands, ordinary = straight.any(axis=1), _ORDINARY["either"]
    if stands.sum() < enough:
        lean = _from_vertical(np.median(along, axis=0))
        if lean <= _OVER:
            doubt = _doubt(np.median(along, axis=0))
            return Turn(doubt=doubt if lean > _LEANING else "")
        # Nobody is upside down for most of a take, legs bent or not.
        stands = np.ones(len(along), dtype=np.bool_)
    along, down = along[stands], down[stands]
    up = unit(np.median(along, axis=0))
    lean = _from_vertical(up)
    if lean <= ordinary:
        return Turn()
    sure = np.mean(along @ up > _SIMILAR) >= _AGREEMENT
    if lean < _OVER:
        # Arms over the head do not carry the person either.
        down = down if lean > _TILTED else np.abs(down)
        sure &= np.mean(down.max(axis=1) > _HANGING) >= _HANGS
    else:
        sure &= np.mean(down.max(axis=1) > _CARRYING) > 1.0 - _AGREEMENT
    if not sure or _TILTED < lean < _OVER:
        return Turn(doubt=_doubt(up))
    if lean >= np.pi - ordinary:
        return Turn(roll=np.pi)  # as near as level sensors are
    roll = np.arctan2(up[0], up[1])
    return Turn(float(roll), -float(np.arctan2(up[2], np.hypot(up[0], up[1]))))


def with_y_up(take: Take) -> Take:
    """Return a take with y up, flipping y if it pointed down.

    So it did if the person is upside down and the toes point backwards: a reflection.
    """
    some = take.positions[:: 1 + len(take) // _FRAMES]
    along, straight, _ = _posture(some, take.skeleton)
    stands = straight.any(axis=1)
    if stands.sum() < max(_MIN_FRAMES, _MIN_SHARE * len(along)):
        return take
    up = unit(np.median(along[stands], axis=0))
    sure = np.mean(along[stands] @ up > _SIMILAR) >= _AGREEMENT
    if _from_vertical(up) < _OVER or not sure or not _mirrored(some, take.skeleton):
        return take
    return replace(take, positions=take.positions * [1.0, -1.0, 1.0])


def _doubt(up: Array) -> str:
    """Return the warning for people whose shoulders are ``up`` from their feet."""
    most, (x, y, _) = np.sin(_ORDINARY["both"]), unit(up)
    tilts = abs(x) < most and y > -most  # which the option can undo, up to 90 degrees
    advice = f"give clean --tilt, or {_ROTATE}" if tilts else _ROTATE
    return _DOUBT.format(np.degrees(_from_vertical(up)), advice)


def _from_vertical(direction: Array) -> float:
    return float(np.arccos(np.clip(unit(direction)[1], -1.0, 1.0)))


def _posture(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags, Array]:
    """Return ``posture_of`` for the N frames with feet and trunk."""
    along, straight, down = posture_of(positions, skeleton)
    seen = ~np.isnan(along).any(axis=1)
    return along[seen], straight[seen], down[seen]


def posture_of(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags, Array]:
    """Return how the person stands, whichever way the frame is turned.

    The direction from the feet to the shoulders (T, 3), NaN without feet or trunk;
    whether each leg is straight and in line with the trunk (T, 2); and the share of its
    length by which each arm reaches down along the body (T, 2).
    """
    ankle, knee, hip, shoulder, elbow, wrist = (
        positions[:, skeleton.sides(part)]
        for part in ("Ankle", "Knee", "Hip", "Shoulder", "Elbow", "Wrist")
    )
    girdle = positions[:, [skeleton.girdle]]
    trunk = unit(girdle - positions[:, [skeleton.root]])
    along = unit(girdle - ankle.mean(axis=1, keepdims=True))
    shank, thigh = unit(knee - ankle), unit(hip - knee)
    straight = np.sum(shank * thigh, axis=2) > _STRAIGHT
    straight &= np.sum(thigh * trunk, axis=2) > _STRAIGHT
    arm = np.linalg.norm(elbow - shoulder, axis=2)
    arm += np.linalg.norm(wrist - elbow, axis=2)
    down = np.sum((shoulder - wrist) * along, axis=2) / np.maximum(arm, 1e-9)
    along = np.where(np.isnan(trunk), np.nan, along)
    return along[:, 0], straight, np.nan_to_num(down)


def _mirrored(positions: Array, skeleton: Skeleton) -> bool:
    """Return True if toes point backwards, judging by left and right.

    Trackers take people whom they see from behind for facing the sensor, and swap their
    sides. Their toes point away from it, and do not count.
    """
    pairs = [skeleton.sides(part) for part in ("Hip", "Shoulder", "Ankle", "Foot")]
    left, right = (positions[:, joints] for joints in np.transpose(pairs))
    up = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    front = np.cross((left - right)[:, :2].sum(axis=1), up)
    toes = (left + right)[:, 3] - (left + right)[:, 2]
    cosines = np.sum(unit(front) * unit(toes), axis=1)
    place = positions[:, skeleton.root, ::2]
    behind = np.sum(unit(place) * toes[:, ::2], axis=1) > 0.0
    behind &= np.linalg.norm(place, axis=1) > NEAREST
    backwards = (cosines < _BACKWARDS) & ~behind
    return bool(2 * backwards.sum() > np.sum(~np.isnan(cosines)))
