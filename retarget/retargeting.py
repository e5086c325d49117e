"""Retargeting to another skeleton: directions kept, own proportions, feet planted.

A limb's direction in the target's rest pose and in our T-pose differ by a constant
rotation. After that, the target's bone rotates like our segment, including twist.
Twist bones spread the twist along a limb, and IK bones follow hands and feet.
Trunk, shoulders and feet have a different shape on every skeleton, so all rest poses
count as upright and flat there, and only headings differ.
"""

from typing import NamedTuple

import numpy as np

from kinefilter.characters import CONTACTS, Body, Clip, Motion, Skeleton
from kinefilter.characters.arrays import Array, read_only
from kinefilter.characters.rotations import (
    IDENTITY,
    about_y,
    between,
    inverse,
    multiply,
    rotate,
    slerp,
    wrapped,
)

from .limbs import (
    bent_limb,
    holding_moves,
    near_stance,
    rejection,
    shortage,
    smooth_step,
)
from .rig_map import NEXT, SIDES
from .standardize import HeadingFrame, floor_frame
from .target_rig import TargetRig, Twist

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
_Limb = tuple[str, str, str]
_ARM: _Limb = ("upper arm", "lower arm", "hand")
_LEG: _Limb = ("thigh", "shin", "foot")
_JOINTS = {_ARM: ("Shoulder", "Elbow", "Wrist"), _LEG: ("Hip", "Knee", "Ankle")}
_BENDS = {_ARM: np.array([0.0, 0.0, -1.0]), _LEG: np.array([0.0, 0.0, 1.0])}
"""Directions in which elbow and knee of our T-pose move when the limb bends."""
_HINGE = 0.025
"""Share of a limb's length by which its middle counts as farther in that direction: a
limb that noise bends backward by 5 degrees still bends correctly. A guess."""
_SLACK = 0.0175
"""Largest distance of a planted foot from its unplanted place, as a share of the leg's
length: 1.5 cm for a leg of 86 cm. A guess."""
_TOE_NEAR = 0.05  # m above the floor, below which toes turn level. A guess.
_STEEP, _SLOPING = 0.3, 0.7  # cosines of the sole's slope between which they do
_UP, _LEVEL = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 1.0])


class Retargeted(NamedTuple):
    """Motion of the joints of another skeleton."""

    rotations: Array  # world rotations from the rest pose, wxyz, shape (T, N, 4)
    positions: Array  # positions [m], floor at y = 0, shape (T, N, 3)


def retarget(clip: Clip, rig: TargetRig) -> Retargeted:
    """Return a clip's motion on another skeleton.

    The path of the hips is scaled about the world's origin by the length of the legs;
    its height counts from the ankles of flat feet. Hands and feet keep their place
    relative to limb length: the vectors from shoulder to wrist and from hip to ankle,
    divided by the length of the limb, are those of the clip. A planted foot
    (``clip.contacts``) is held still within 1.75 % of the leg's length, and where the
    leg is too short, the hips sink. Ancestors of the pelvis follow it on the floor, and
    IK bones are where the joints are that they follow.
    """
    motion = _Motion(clip, rig)
    goals = [motion.limb_end(side, _LEG) for side in SIDES]
    sinking = np.zeros(len(clip))
    for side, goal in zip(SIDES, goals, strict=True):
        share = motion.plant(side, goal)
        leg = motion.positions[:, rig.joint(f"{side} thigh")] - goal
        short = shortage(leg, rig.limb(side, *_LEG).sum())
        sinking = np.maximum(sinking, share * short)
    motion.positions[..., 1] -= sinking[:, None]
    hips = motion.positions[:, rig.joint("pelvis")]
    for side, goal in zip(SIDES, goals, strict=True):
        motion.bend(side, _LEG, goal)
        motion.bend(side, _ARM, motion.limb_end(side, _ARM))
    result = motion.posed(hips)
    _move_ancestors(rig, result)
    for bone, joint in rig.followed.items():
        for values in result:
            values[:, bone] = values[:, joint]
    return Retargeted(*map(read_only, result))


def rig_frame(rig: TargetRig, motion: Retargeted) -> HeadingFrame:
    """Return a skeleton's place on the floor and heading relative to the rest pose."""
    pelvis, left = rig.joint("pelvis"), rig.bone("right thigh", "left thigh")
    return floor_frame(motion.positions[:, pelvis], motion.rotations[:, pelvis], left)


def _move_ancestors(rig: TargetRig, motion: Retargeted) -> None:
    """Move joints that do not descend from the pelvis along with it, in place."""
    rest, pelvis = rig.rest, rig.joint("pelvis")
    led = np.ones(len(rest), dtype=np.bool_)
    for n, parent in enumerate(rest.parents):
        led[n] = n != pelvis and (parent < 0 or led[parent])
    frame = rig_frame(rig, motion)
    below = rest.positions[led] - rest.positions[pelvis] * _LEVEL
    motion.positions[:, led] = frame.restore(np.tile(below, (len(frame.yaw), 1, 1)))
    motion.rotations[:, led] = about_y(frame.yaw)[:, None]


class _Motion:
    """Working state of a motion: rotations of joints by index, and all positions."""

    def __init__(self, clip: Clip, rig: TargetRig) -> None:
        self.clip, self.rig = clip, rig
        self.turns = turned(clip, rig)
        ours = np.mean([self._our_length(side, _LEG) for side in SIDES])
        self._scale = rig.leg_length / float(ours)
        _, self.positions = self.posed(self._hips())

    def _our(self, side: str, joint: str) -> int:
        return self.clip.skeleton.index(f"{joint}{side.capitalize()}")

    def _our_length(self, side: str, limb: _Limb) -> float:
        _, middle, end = (self._our(side, joint) for joint in _JOINTS[limb])
        return float(self.clip.body.lengths[[middle, end]].sum())

    def _ankle_height(self, side: str) -> float:
        """Return the height [m] of the target's ankle above its flat sole."""
        joint = self.rig.joint(f"{side} foot")
        return float(self.rig.rest.positions[joint, 1]) - self.rig.floor

    def _hips(self) -> Array:
        """Return the path of the target's pelvis [m], shape (T, 3)."""
        clip, rest = self.clip, self.rig.rest.positions
        path = clip.positions[:, clip.skeleton.hips].mean(axis=1)
        ankles = clip.skeleton.sides("Ankle")
        path = path - clip.body.rest_positions[ankles, 1].mean() * _UP
        path = path * self._scale
        path += np.mean([self._ankle_height(side) for side in SIDES]) * _UP
        pelvis = self.rig.joint("pelvis")
        thighs = [self.rig.joint(f"{side} thigh") for side in SIDES]
        above = rest[pelvis] - rest[thighs].mean(axis=0)
        return np.asarray(path + rotate(self.turns[pelvis], above))

    def posed(self, hips: Array) -> Retargeted:
        """Return the motion of all joints, with the pelvis at ``hips`` [m] (T, 3)."""
        rest, pelvis = self.rig.rest, self.rig.joint("pelvis")
        turns = self.turns | twisted(self.rig.twists, self.turns)
        rotations = np.empty((len(self.clip), len(rest), 4))
        positions = np.empty((len(self.clip), len(rest), 3))
        for n, parent in enumerate(rest.parents):
            above = IDENTITY if parent < 0 else rotations[:, parent]
            rotations[:, n] = turns.get(n, above)
            if n == pelvis:
                positions[:, n] = hips
            elif parent < 0:
                positions[:, n] = rest.positions[n]
            else:
                bone = rest.positions[n] - rest.positions[parent]
                positions[:, n] = positions[:, parent] + rotate(above, bone)
        return Retargeted(rotations, positions)

    def limb_end(self, side: str, limb: _Limb) -> Array:
        """Return the end of a limb that is our limb, scaled [m], shape (T, 3)."""
        first, _, last = (self._our(side, joint) for joint in _JOINTS[limb])
        vector = self.clip.positions[:, last] - self.clip.positions[:, first]
        length = self.rig.limb(side, *limb).sum()
        start = self.positions[:, self.rig.joint(f"{side} {limb[0]}")]
        return np.asarray(start + length / self._our_length(side, limb) * vector)

    def plant(self, side: str, goal: Array) -> Array:
        """Move the ankle's goal [m] in place so that a planted foot stays still.

        Heel (by the ankle above it) and toes are held separately; the foot points from
        one to the other. Returns ``near_stance`` of the foot.
        """
        time, foot = self.clip.time, self.rig.joint(f"{side} foot")
        first = CONTACTS.index(f"Heel{side.capitalize()}")
        heel_planted, toe_planted = self.clip.contacts.T[first : first + 2]
        vector, ankle = self._foot(side), self._ankle_height(side)
        sole, slack = ankle + vector[1], _SLACK * self.rig.leg_length
        toes = rotate(self.turns[foot], vector)
        heel = goal + holding_moves(time, goal, heel_planted, ankle, slack)
        toe = goal + toes + holding_moves(time, goal + toes, toe_planted, sole, slack)
        toe[:, 1] = np.maximum(toe[:, 1], sole)
        on_toes = near_stance(time, toe_planted)
        heel[:, 1] += np.maximum(ankle - heel[:, 1], 0.0) * on_toes
        turn = between(toes, toe - heel)
        self.turns[foot] = turns = multiply(turn, self.turns[foot])
        toes = rotate(turns, vector)
        goal[:] = heel + on_toes[:, None] * (toe - toes - heel)
        goal[:, 1] += np.maximum(sole - (goal + toes)[:, 1], 0.0)
        if f"{side} toes" in self.rig.parts:
            # Toes near the floor turn level even if the heel is raised.
            up = rotate(turns, _UP)
            share = smooth_step(1.0 - ((goal + toes)[:, 1] - sole) / _TOE_NEAR)
            share *= smooth_step((up[:, 1] - _STEEP) / (_SLOPING - _STEEP))
            level = multiply(between(up, np.broadcast_to(_UP, up.shape)), turns)
            self.turns[self.rig.joint(f"{side} toes")] = slerp(turns, level, share)
        return near_stance(time, heel_planted | toe_planted)

    def _foot(self, side: str) -> Array:
        """Return the vector [m] from ankle to toes in the rest pose, shape (3,)."""
        if f"{side} toes" in self.rig.parts:
            return self.rig.bone(f"{side} foot", f"{side} toes")
        foot = self._our(side, "Foot")
        ours = self._scale * self.clip.body.rest_offsets[foot]
        theirs = rotate(inverse(heading(self.rig)), ours)
        sole = self._scale * self.clip.body.radii[foot]
        return np.asarray(theirs * _LEVEL + (sole - self._ankle_height(side)) * _UP)

    def bend(self, side: str, limb: _Limb, goal: Array) -> None:
        """Turn the two bones of a limb so that it ends at a goal [m], shape (T, 3)."""
        first, second, last = (f"{side} {part}" for part in limb)
        upper, lower = self.rig.joint(first), self.rig.joint(second)
        start = self.positions[:, upper]
        lengths = self.rig.limb(side, *limb)
        middle, end = bent_limb(start, goal, self._toward(side, limb), lengths)
        for joint, rest, bone in (
            (upper, self.rig.bone(first, second), middle - start),
            (lower, self.rig.bone(second, last), end - middle),
        ):
            turn = self.turns[joint]
            self.turns[joint] = multiply(between(rotate(turn, rest), bone), turn)

    def _toward(self, side: str, limb: _Limb) -> Array:
        """Return the direction in which a limb bends, shape (T, 3)."""
        joints = [self._our(side, joint) for joint in _JOINTS[limb]]
        start, middle, end = self.clip.positions[:, joints].swapaxes(0, 1)
        beside = rejection(middle - start, end - start)
        segment = segment_of(self.clip.skeleton, f"{side} {limb[0]}")
        hinge = rotate(self.clip.rotations[:, segment], _BENDS[limb])
        least = _HINGE * self._our_length(side, limb)
        bent = np.linalg.norm(beside, axis=1)
        bent += np.maximum(np.sum(beside * hinge, axis=1), 0.0)
        straight = smooth_step(2.0 - bent / least)
        return np.asarray(beside + least * straight[:, None] * hinge)


def angle_about(axis: Array, rotations: Array) -> Array:
    """Return the twist [rad] of rotations (..., 4) about a unit vector, within pi."""
    return wrapped(2.0 * np.arctan2(rotations[..., 1:] @ axis, rotations[..., 0]))


def twisted(twists: dict[int, Twist], turns: dict[int, Array]) -> dict[int, Array]:
    """Return the rotation of each twist bone, given those of the other joints.

    Both are world rotations from the rest pose, wxyz, (T, 4), by index of the joint.
    """
    found = {}
    for bone, (limb, joint, above, axis, share) in twists.items():
        angle = angle_about(axis, multiply(inverse(turns[above]), turns[joint]))
        half = 0.5 * share * angle[:, None]
        turn = np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)
        found[bone] = multiply(turns[limb], turn)
    return found


def segment_of(skeleton: Skeleton, part: str) -> int:
    """Return the index of the segment that turns a part of the body."""
    side, _, limb = part.partition(" ")
    if limb:
        return skeleton.index(f"{_SEGMENTS[limb]}{side.capitalize()}")
    head, chest = skeleton.index("Head"), skeleton.girdle
    neck = head if skeleton.parents[head] == chest else skeleton.parents[head]
    return {"pelvis": skeleton.root, "spine": chest, "neck": neck, "head": head}[part]


def turned(motion: Motion, rig: TargetRig) -> dict[int, Array]:
    """Return the world rotations (T, 4) from the rest pose, by index of the joint."""
    facing, turns = heading(rig), {}
    for part, joints in rig.parts.items():
        if part != "spine":
            segment = motion.rotations[:, segment_of(motion.skeleton, part)]
            turn = multiply(segment, _difference(rig, part, motion.body, facing))
            turns.update(dict.fromkeys(joints, turn))
    lower = motion.rotations[:, motion.skeleton.parents[motion.skeleton.girdle]]
    upper = motion.rotations[:, motion.skeleton.girdle]
    spine = rig.parts["spine"]
    for k, joint in enumerate(spine):
        # The lowest joint turns with the lower spine, the highest with the chest.
        share = k / (len(spine) - 1) if len(spine) > 1 else 1.0
        turn = slerp(lower, upper, np.full(len(motion), share))
        turns[joint] = multiply(turn, facing)
    return turns


def heading(rig: TargetRig) -> Array:
    """Return the rotation about y that makes the rest pose face +z, wxyz, (4,)."""
    x, _, z = rig.bone("right thigh", "left thigh")
    return about_y(np.arctan2(z, x))


def _difference(rig: TargetRig, part: str, body: Body, facing: Array) -> Array:
    """Return the rotation from the target's rest pose to our T-pose, wxyz, (4,)."""
    side, _, limb = part.partition(" ")
    if limb == "hand":
        return _difference(rig, f"{side} lower arm", body, facing)
    ours = body.rest_offsets[segment_of(body.skeleton, part)]
    if part in NEXT:
        theirs = rotate(facing, rig.bone(part, NEXT[part]))
        return multiply(between(theirs, ours), facing)
    if limb in ("foot", "toes") and f"{side} toes" in rig.parts:
        theirs = rotate(facing, rig.bone(f"{side} foot", f"{side} toes"))
        return multiply(between(_LEVEL * theirs, _LEVEL * ours), facing)
    return facing
