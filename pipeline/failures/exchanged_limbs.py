"""Finds limbs whose left and right a sensor exchanges alone, and puts them back.

From a frame to the next, both leap to each other's places, from some joint outward, and
later back.
"""

from itertools import pairwise

import numpy as np

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, Indices

from .sides import with_joints

# Chosen on p00 to p08 of two-kinects, with limbs exchanged in them, and on s02, s03 and
# s04 of UI-PRMD.
_ACROSS = 0.1  # m that joints leap to the other side at least
_NEARER = 0.6  # share of that by which they miss the other side's place at most

EXCHANGED = {
    "arms from the shoulders": ("Hip", "Shoulder"),
    "arms from the elbows": ("Shoulder", "Elbow"),
    "arms from the wrists": ("Elbow", "Wrist"),
    "legs from the knees": ("Hip", "Knee"),
    "legs from the ankles": ("Knee", "Ankle"),
}
"""Parts that may be exchanged: the last joint that stays, and the first that leaps."""


def exchanged_joints(skeleton: Skeleton, part: str) -> Indices:
    """Return the joints of a part of EXCHANGED, on both sides."""
    first = skeleton.sides(EXCHANGED[part][1])
    return np.array([j for k in first for j in (k, *skeleton.descendants(k))])


def exchanged_frames(take: Take, part: str) -> Flags:
    """Return where a take has left and right of a part of EXCHANGED exchanged, (T,).

    Between two leaps, or up to an end of the take, the limbs are attached crosswise.
    """
    skeleton = take.skeleton
    joints = exchanged_joints(skeleton, part)
    last, first = (np.array(skeleton.sides(name)) for name in EXCHANGED[part])
    paired = np.flatnonzero(skeleton.mirror != np.arange(len(skeleton)))
    rest = np.setdiff1d(paired, joints)
    leap = np.ones(len(take) - 1, dtype=bool)
    for some in (first, joints):
        same, other = _moved(take, some)
        leap &= (same > _ACROSS) & (other < _NEARER * same)
    for some in (last, rest):
        same, other = _moved(take, some)
        leap &= same < other
    straight, crosswise = (
        np.linalg.norm(take.positions[:, last] - ends, axis=2).sum(axis=1)
        for ends in (take.positions[:, first], take.positions[:, first[::-1]])
    )
    frames = np.zeros(len(take), dtype=bool)
    ends = (np.flatnonzero(leap) + 1).tolist()
    for begin, end in pairwise([0, *ends, len(take)] if ends else ()):
        frames[begin:end] = np.mean(crosswise[begin:end] < straight[begin:end]) > 0.5
    return frames


def _moved(take: Take, joints: Indices) -> tuple[Array, Array]:
    """Return how far joints are from where they and the other side were before [m]."""
    seen, before = take.positions, (joints, take.skeleton.mirror[joints])
    ways = [np.linalg.norm(seen[1:, joints] - seen[:-1, k], axis=2) for k in before]
    known = np.asarray(np.isfinite(ways).all(axis=0))
    count = np.where(known.any(axis=1), known.sum(axis=1), np.nan)
    same, other = (np.where(known, way, 0.0).sum(axis=1) / count for way in ways)
    return same, other


def put_back(take: Take, part: str, frames: slice) -> Take:
    """Return a take with left and right of a part of EXCHANGED put back in frames."""
    joints = exchanged_joints(take.skeleton, part)
    flags = np.isin(np.arange(len(take.skeleton)), joints)
    return with_joints(take, take.swapped(frames), flags)
