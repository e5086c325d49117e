"""How the bones of another skeleton turn when our segments do.

Where a limb of the target points in its rest pose and where ours points in the T-pose
differ by a constant rotation, so its bone is turned as our segment is, twist included,
after that. Trunk, shoulders and feet have another shape on every skeleton: there each
rest pose counts as upright and flat, and only headings differ.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Motion, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, between, multiply, rotate, slerp

from .target_rig import TargetRig

_SEGMENTS = {
    "clavicle": "Shoulder",
    "upper arm": "Elbow",
    "lower arm": "Wrist",
    "hand": "Hand",
    "thigh": "Knee",
    "shin": "Ankle",
    "foot": "Foot",
    "toes": "Foot",
}
_ENDS = {
    "upper arm": "lower arm",
    "lower arm": "hand",
    "thigh": "shin",
    "shin": "foot",
}


def segment_of(skeleton: Skeleton, part: str) -> int:
    """Return the index of the segment, by the joint it ends at, that turns a part."""
    side, _, limb = part.partition(" ")
    if limb:
        return skeleton.index(f"{_SEGMENTS[limb]}{side.capitalize()}")
    head, chest = skeleton.index("Head"), skeleton.girdle
    neck = head if skeleton.parents[head] == chest else skeleton.parents[head]
    return {"pelvis": skeleton.root, "neck": neck, "head": head}[part]


def turned(motion: Motion, rig: TargetRig) -> dict[int, Array]:
    """Return the world rotation (T, 4) since the rest pose of joints by index."""
    facing, turns = heading(rig), {}
    for part, joints in rig.parts.items():
        if part == "spine":
            continue
        segment = motion.rotations[:, segment_of(motion.skeleton, part)]
        turn = multiply(segment, _difference(rig, part, motion.body, facing))
        turns.update(dict.fromkeys(joints, turn))
    lower = motion.rotations[:, motion.skeleton.parents[motion.skeleton.girdle]]
    upper = motion.rotations[:, motion.skeleton.girdle]
    spine = rig.parts["spine"]
    for k, joint in enumerate(spine):
        # From the lowest, which the lower spine turns, to the chest.
        share = k / (len(spine) - 1) if len(spine) > 1 else 1.0
        turn = slerp(lower, upper, np.full(len(motion), share))
        turns[joint] = multiply(turn, facing)
    return turns


def heading(rig: TargetRig) -> Array:
    """Return the rotation about y after which the rest pose faces +z, wxyz, (4,)."""
    x, _, z = rig.bone("right thigh", "left thigh")
    return about_y(np.arctan2(z, x))


def _difference(rig: TargetRig, part: str, body: Body, facing: Array) -> Array:
    """Return the rotation from the target's rest pose to our T-pose, wxyz, (4,)."""
    side, _, limb = part.partition(" ")
    if limb == "hand":
        return _difference(rig, f"{side} lower arm", body, facing)
    ours = body.rest_offsets[segment_of(body.skeleton, part)]
    if limb in _ENDS:
        theirs = rotate(facing, rig.bone(part, f"{side} {_ENDS[limb]}"))
        return multiply(between(theirs, ours), facing)
    if limb in ("foot", "toes") and f"{side} toes" in rig.parts:
        theirs = rotate(facing, rig.bone(f"{side} foot", f"{side} toes"))
        level = np.array([1.0, 0.0, 1.0])
        return multiply(between(level * theirs, level * ours), facing)
    return facing
