"""The joints of each limb, and the hidden part of a limb."""

from __future__ import annotations

from functools import cache

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices

from .windows import Limb

_MOSTLY_SEEN = 0.9  # share of a gap's frames in which a visible segment is seen
_TIPS = ("Hand", "Foot", "Thumb")
_LIMBS = (("Shoulder", "Elbow", "Wrist"), ("Hip", "Knee", "Ankle"))


@cache
def limbs(skeleton: Skeleton) -> tuple[tuple[int, int, int], ...]:
    """Return shoulder, elbow and wrist, or hip, knee and ankle, of each limb."""
    arms, legs = (zip(*map(skeleton.sides, limb), strict=True) for limb in _LIMBS)
    return tuple(limb for side in zip(arms, legs, strict=True) for limb in side)


@cache
def in_limbs(skeleton: Skeleton) -> Flags:
    """Return True for joints beyond a shoulder or a hip, shape (J,)."""
    inside = np.zeros(len(skeleton), dtype=np.bool_)
    for top, _, _ in limbs(skeleton):
        inside[skeleton.descendants(top)] = True
    return inside


def with_tips(hidden: Flags, skeleton: Skeleton) -> Flags:
    """Return flags (..., J) in which hidden wrists and ankles hide hands and feet.

    A hand without its wrist shows only its own position, not that of the arm.
    """
    return np.asarray(hidden | hidden[..., _ends(skeleton)])


@cache
def _ends(skeleton: Skeleton) -> Indices:
    """Return the wrist or ankle of hand and foot joints, others themselves, (J,)."""
    ends = np.arange(len(skeleton))
    for _, _, end in limbs(skeleton):
        ends[skeleton.descendants(end)] = end
    return ends


def limb_of(
    skeleton: Skeleton, joints: tuple[int, int, int], known: Array
) -> Limb | None:
    """Return the hidden part of a limb, given from the trunk outwards, or None.

    ``known`` (J,) is the share of a gap's frames in which each segment is seen, NaN for
    one that is never seen.
    """
    gone = tuple(j for j in joints[1:] if known[j] < 0.5)
    if not gone:
        return None
    visible = tuple(
        j
        for j in skeleton.segments.tolist()
        if j not in gone
        and known[j] >= _MOSTLY_SEEN
        and not skeleton.joints[j].startswith(_TIPS)
    )
    is_leg = skeleton.joints[joints[0]].startswith("Hip") and joints[2] in gone
    return Limb(gone, visible, joints if is_leg else None)
