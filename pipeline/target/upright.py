"""Which way is up in a take, from how the person stands.

Somebody who stands on straight legs under a straight trunk is upright to within a few
degrees, or they would fall. Where that line is far from the vertical in most of a take,
it is the sensor's frame that was turned. People on the floor, on their hands or bent
over are left as they are: a straight body that lies tells nothing, and somebody whose
arms carry them has none that hangs along the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import unit

_STRAIGHT = np.cos(np.radians(30.0))
"""Cosine of the angle between shank, thigh and trunk from which on somebody does not
stand straight. A guess."""
_HANGING = 0.8
"""Share of its length by which an arm that hangs reaches down the body. A guess."""
_ORDINARY = {"both": np.radians(15.0), "either": np.radians(20.0)}
"""Angle to the vertical [rad] up to which nothing is done, where both legs or at least
one are straight often enough. Before sensors as people set them up, 1,254 clips of 20
people have 10.4 and 15.0 degrees at most; marker mocap, dances among it, 2.9 and 15.5.
"""
_TILTED, _OVER = np.radians([60.0, 135.0])
"""Angles [rad] between which people may as well lie on the floor."""
_OFTEN = 0.25  # share of all frames in which they stand straight. Dancers pose in 0.2
_LEAST = 15  # frames in which they do: half a second
_ALIKE, _MOST = np.cos(np.radians(20.0)), 0.8
"""In this share of them the body is within 20 degrees of their median. Guesses."""
_HANGS = 0.1  # share of them in which an arm hangs: 1,000 of the clips above have more
_CARRYING = -0.3
"""The same share of arms in a handstand or headstand is lower: hands on the floor are
as far from the shoulders as the head. A guess."""
_LEANING = np.radians(30.0)  # of all frames, whatever people do; there 25 at most
_BACKWARDS = -0.25  # median cosine between toes and front; in the clips above 0.26 up
_MIRRORED = (
    "toes point backwards in most frames: left and right are exchanged, or an axis "
    "points the wrong way; if y points down, negate it"
)
_DOUBT = (
    "the person is {:.0f} degrees off the vertical in most frames, and nothing tells "
    "whether that is what they do or the sensor was turned; if it was, turn the frames "
    "so that y points up, or give clean --tilt"
)
_FRAMES = 5000  # that are looked at: enough for medians


@dataclass(frozen=True)
class Turn:
    """How a sensor's frame has to be turned so that the person stands upright."""

    roll: float = 0.0
    """About z [rad], first; see ``leveled``."""
    tilt: float = 0.0
    """About x [rad], then."""
    doubt: str = ""
    """What the user should know where the frame may be wrong, but was left as it is."""

    def told(self, leveled: float = 0.0) -> tuple[str, ...]:
        """Return what the user should know, leveled by that angle [rad] besides."""
        tilt, notes = np.degrees(self.tilt + leveled), []
        if self.roll:
            what = "upside down" if abs(self.roll) > np.pi / 2.0 else "tilted"
            then = f", then by {tilt:+.1f} about x" if tilt else ""
            notes.append(
                f"the sensor was {what}, going by how the person stands: frames were "
                f"turned by {np.degrees(self.roll):+.1f} degrees about z{then}"
            )
        elif tilt:
            notes.append(f"the sensor was tilted by {tilt:+.1f} degrees")
        return (*notes, *([self.doubt] if self.doubt else []))


def find_turn(positions: Array, skeleton: Skeleton, least: int = _LEAST) -> Turn:
    """Return the turn of a take, none where it is ordinary or not sure.

    Joint positions [m] are in the sensor's frame, y up, NaN where missing, shape
    (T, J, 3); somebody has to stand in ``least`` of the frames.
    """
    positions = positions[:: 1 + len(positions) // _FRAMES]
    along, straight, down = _bearing(positions, skeleton)
    if not len(along):
        return Turn()
    if _mirrored(positions, skeleton):
        return Turn(doubt=_MIRRORED)
    return _judged(along, straight, down, least)


def _judged(along: Array, straight: Flags, down: Array, least: int) -> Turn:
    """Return the turn for people who bear themselves so; see ``_bearing``."""
    enough = max(least, _OFTEN * len(along))
    stands, ordinary = straight.all(axis=1), _ORDINARY["both"]
    if stands.sum() < enough:
        stands, ordinary = straight.any(axis=1), _ORDINARY["either"]
    if stands.sum() < enough:
        lean = _from_vertical(np.median(along, axis=0))
        if lean <= _OVER:
            leans = lean > _LEANING
            return Turn(doubt=_DOUBT.format(np.degrees(lean)) if leans else "")
        # Nobody is on the head for most of a take, legs bent or not.
        stands = np.ones(len(along), dtype=np.bool_)
    along, down = along[stands], down[stands]
    up = unit(np.median(along, axis=0))
    lean = _from_vertical(up)
    if lean <= ordinary:
        return Turn()
    sure = np.mean(along @ up > _ALIKE) >= _MOST
    if lean < _OVER:
        # Arms over the head carry nobody either.
        down = down if lean > _TILTED else np.abs(down)
        sure &= np.mean(down.max(axis=1) > _HANGING) >= _HANGS
    else:
        sure &= np.mean(down.max(axis=1) > _CARRYING) > 1.0 - _MOST
    if not sure or _TILTED < lean < _OVER:
        return Turn(doubt=_DOUBT.format(np.degrees(lean)))
    if lean >= np.pi - ordinary:
        return Turn(roll=np.pi)  # as near as level sensors are
    roll = np.arctan2(up[0], up[1])
    return Turn(float(roll), -float(np.arctan2(up[2], np.hypot(up[0], up[1]))))


def with_y_up(take: Take) -> Take:
    """Return a take whose y axis pointed down with y up; others as they are.

    Of frames upside down these are those in which toes point backwards: a mirror, which
    no turn of the sensor undoes.
    """
    some = take.positions[:: 1 + len(take) // _FRAMES]
    along, straight, _ = _bearing(some, take.skeleton)
    stands = straight.any(axis=1)
    if stands.sum() < max(_LEAST, _OFTEN * len(along)):
        return take
    up = unit(np.median(along[stands], axis=0))
    alike = np.mean(along[stands] @ up > _ALIKE) >= _MOST
    if _from_vertical(up) < _OVER or not alike or not _mirrored(some, take.skeleton):
        return take
    return replace(take, positions=take.positions * [1.0, -1.0, 1.0])


def _from_vertical(direction: Array) -> float:
    return float(np.arccos(np.clip(unit(direction)[1], -1.0, 1.0)))


def _bearing(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags, Array]:
    """Return how people bear themselves, whichever way up the frame is.

    The direction from the feet to the shoulders (N, 3), which legs are straight, under
    a straight trunk (N, 2), and which share of its length each arm hangs down along the
    body (N, 2), in the frames that show feet and trunk.
    """
    ankle, knee, hip, shoulder, elbow, wrist = (
        positions[:, skeleton.sides(part)]
        for part in ("Ankle", "Knee", "Hip", "Shoulder", "Elbow", "Wrist")
    )
    girdle = positions[:, [skeleton.girdle]]
    trunk = unit(girdle - positions[:, [skeleton.root]])
    along = unit(girdle - ankle.mean(axis=1, keepdims=True))
    shank, thigh = unit(knee - ankle), unit(hip - knee)
    straight = (np.sum(shank * thigh, axis=2) > _STRAIGHT) & (
        np.sum(thigh * trunk, axis=2) > _STRAIGHT
    )
    arm = np.linalg.norm(elbow - shoulder, axis=2)
    arm += np.linalg.norm(wrist - elbow, axis=2)
    down = np.sum((shoulder - wrist) * along, axis=2) / np.maximum(arm, 1e-9)
    seen = ~np.isnan(along + trunk).any(axis=(1, 2))
    return along[seen, 0], straight[seen], np.nan_to_num(down[seen])


def _mirrored(positions: Array, skeleton: Skeleton) -> bool:
    """Return whether toes point backwards, by where left and right are."""
    pairs = [skeleton.sides(part) for part in ("Hip", "Shoulder", "Ankle", "Foot")]
    left, right = (positions[:, joints] for joints in np.transpose(pairs))
    up = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    front = np.cross((left - right)[:, :2].sum(axis=1), up)
    toes = (left + right)[:, 3] - (left + right)[:, 2]
    cosines = np.sum(unit(front) * unit(toes), axis=1)
    cosines = cosines[~np.isnan(cosines)]
    return bool(len(cosines) and np.median(cosines) < _BACKWARDS)
