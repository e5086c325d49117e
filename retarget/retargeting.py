"""A motion on another skeleton: directions kept, proportions its own, feet planted.

Where a limb of the target points in its rest pose and where ours points in the T-pose
differ by a constant rotation, so its bone is turned as our segment is, twist included,
after that. Trunk, shoulders and feet have another shape on every skeleton: there each
rest pose counts as upright and flat, and only headings differ.
"""

from __future__ import annotations

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
)

from .bent_limb import bent_limb
from .heading_frame import HeadingFrame, floor_frame
from .rig_map import SIDES
from .stance import held, near_stance, smooth_step
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
_ENDS = {"upper arm": "lower arm", "lower arm": "hand", "thigh": "shin", "shin": "foot"}
_Limb = tuple[str, str, str]
_ARM: _Limb = ("upper arm", "lower arm", "hand")
_LEG: _Limb = ("thigh", "shin", "foot")
_JOINTS = {_ARM: ("Shoulder", "Elbow", "Wrist"), _LEG: ("Hip", "Knee", "Ankle")}
_BENDS = {_ARM: np.array([0.0, 0.0, -1.0]), _LEG: np.array([0.0, 0.0, 1.0])}
"""Where elbow and knee of our T-pose go when the limb bends."""
_HINGE = 0.025
"""Share of a limb's length by which its middle counts as farther out that way: a limb
that noise bent backwards by 5 degrees still bends as it should. A guess."""
_SLACK = 0.0175
"""How far aside a standing foot may rest from where it would be relative to the hips, a
share of the leg's length: 1.5 cm of a leg of 86 cm. A guess."""
_TOE_NEAR = 0.05  # m over the floor: toes that are lower are level. A guess.
_STEEP, _SLOPING = 0.3, 0.7  # cosines of the sole's slope: toes are level below it
_UP, _LEVEL = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 1.0])


class Retargeted(NamedTuple):
    """Where another skeleton's joints are, and how they are turned.

    World rotations since the rest pose, wxyz, shape (T, N, 4); positions [m], floor at
    y = 0, shape (T, N, 3).
    """

    rotations: Array
    positions: Array


def retarget(clip: Clip, rig: TargetRig) -> Retargeted:
    """Return a clip's motion on another skeleton.

    The path of the hips is scaled about the world's origin by the length of the legs;
    its height is that over the ankles of flat feet. Hands and feet are at the same
    place relative to limb length: the vector from shoulder to wrist over the length of
    the arm, and that from hip to ankle over the length of the leg, are the clip's. A
    foot that stands (``clip.contacts``) is held still, up to 1.75 % of the leg from
    there, and where its leg is too short the hips sink. What the pelvis hangs on goes
    over the floor straight below it, with its heading.
    """
    motion = _Motion(clip, rig)
    goals = [motion.limb_end(side, _LEG) for side in SIDES]
    sinking = np.zeros(len(clip))
    for side, goal in zip(SIDES, goals, strict=True):
        share = motion.plant(side, goal)
        sinking = np.maximum(sinking, share * motion.shortage(side, goal))
    motion.positions[..., 1] -= sinking[:, None]
    hips = motion.positions[:, rig.joint("pelvis")]
    for side, goal in zip(SIDES, goals, strict=True):
        motion.bend(side, _LEG, goal)
        motion.bend(side, _ARM, motion.limb_end(side, _ARM))
    found = motion.posed(hips)
    _lead(rig, found)
    return Retargeted(*map(read_only, found))


def rig_frame(rig: TargetRig, motion: Retargeted) -> HeadingFrame:
    """Return where on the floor a skeleton is, and how far it has turned there."""
    pelvis, left = rig.joint("pelvis"), rig.bone("right thigh", "left thigh")
    return floor_frame(motion.positions[:, pelvis], motion.rotations[:, pelvis], left)


def _lead(rig: TargetRig, motion: Retargeted) -> None:
    """Move (in place) what does not hang on the pelvis over the floor, as it moves."""
    rest, pelvis = rig.rest, rig.joint("pelvis")
    led = np.ones(len(rest), dtype=np.bool_)
    for node, parent in enumerate(rest.parents):
        led[node] = node != pelvis and (parent < 0 or led[parent])
    frame = rig_frame(rig, motion)
    below = rest.positions[led] - rest.positions[pelvis] * _LEVEL
    motion.positions[:, led] = frame.restore(np.tile(below, (len(frame.yaw), 1, 1)))
    motion.rotations[:, led] = about_y(frame.yaw)[:, None]


class _Motion:
    """The motion while it is found: joints that parts turn, and where all are."""

    def __init__(self, clip: Clip, rig: TargetRig) -> None:
        self.clip, self.rig = clip, rig
        self.turns = turned(clip, rig)
        _, self.positions = self.posed(self._hips())

    def _our(self, side: str, joint: str) -> int:
        return self.clip.skeleton.index(f"{joint}{side.capitalize()}")

    def _our_length(self, side: str, limb: _Limb) -> float:
        _, middle, end = (self._our(side, joint) for joint in _JOINTS[limb])
        return float(self.clip.body.lengths[[middle, end]].sum())

    @property
    def _scale(self) -> float:
        ours = np.mean([self._our_length(side, _LEG) for side in SIDES])
        return self.rig.leg_length / float(ours)

    def _ankle_height(self, side: str) -> float:
        """Return the height [m] of the target's ankle over its flat sole."""
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
        """Return rotations and positions of all joints, given those of the hips."""
        rest, pelvis = self.rig.rest, self.rig.joint("pelvis")
        rotations = np.empty((len(self.clip), len(rest), 4))
        positions = np.empty((len(self.clip), len(rest), 3))
        for n, parent in enumerate(rest.parents):
            above = IDENTITY if parent < 0 else rotations[:, parent]
            rotations[:, n] = self.turns.get(n, above)
            if n == pelvis:
                positions[:, n] = hips
            elif parent < 0:
                positions[:, n] = rest.positions[n]
            else:
                bone = rest.positions[n] - rest.positions[parent]
                positions[:, n] = positions[:, parent] + rotate(above, bone)
        return Retargeted(rotations, positions)

    def limb_end(self, side: str, limb: _Limb) -> Array:
        """Return where a limb ends if it is our scaled one [m], shape (T, 3)."""
        first, _, last = (self._our(side, joint) for joint in _JOINTS[limb])
        vector = self.clip.positions[:, last] - self.clip.positions[:, first]
        length = self.rig.limb(side, *limb).sum()
        start = self.positions[:, self.rig.joint(f"{side} {limb[0]}")]
        return np.asarray(start + length / self._our_length(side, limb) * vector)

    def plant(self, side: str, goal: Array) -> Array:
        """Move the ankle's goal [m] so that the foot rests while it stands.

        Heel and toes are held each for itself, the heel by the ankle over it, and the
        foot points from the one to the other. Returns the share of standing in each
        frame, shape (T,).
        """
        time, foot = self.clip.time, self.rig.joint(f"{side} foot")
        heel_stands, toe_stands = (
            self.clip.contacts[:, CONTACTS.index(f"{part}{side.capitalize()}")]
            for part in ("Heel", "Toe")
        )
        vector, ankle = self._foot(side), self._ankle_height(side)
        sole, slack = ankle + vector[1], _SLACK * self.rig.leg_length
        toes = rotate(self.turns[foot], vector)
        heel = goal + held(time, goal, heel_stands, ankle, slack)
        toe = goal + toes + held(time, goal + toes, toe_stands, sole, slack)
        toe[:, 1] = np.maximum(toe[:, 1], sole)
        on_toes = near_stance(time, toe_stands)
        heel[:, 1] += np.maximum(ankle - heel[:, 1], 0.0) * on_toes
        turn = between(toes, toe - heel)
        self.turns[foot] = multiply(turn, self.turns[foot])
        toes = rotate(self.turns[foot], vector)
        goal[:] = heel + on_toes[:, None] * (toe - toes - heel)
        goal[:, 1] += np.maximum(sole - (goal + toes)[:, 1], 0.0)
        if f"{side} toes" in self.rig.parts:
            # Toes near the floor are turned flat, below a foot whose heel is up.
            turns = self.turns[foot]
            up = rotate(turns, _UP)
            share = smooth_step(1.0 - ((goal + toes)[:, 1] - sole) / _TOE_NEAR)
            share *= smooth_step((up[:, 1] - _STEEP) / (_SLOPING - _STEEP))
            level = multiply(between(up, np.broadcast_to(_UP, up.shape)), turns)
            self.turns[self.rig.joint(f"{side} toes")] = slerp(turns, level, share)
        return near_stance(time, heel_stands | toe_stands)

    def _foot(self, side: str) -> Array:
        """Return the vector [m] from ankle to toes in the rest pose, shape (3,)."""
        if f"{side} toes" in self.rig.parts:
            return self.rig.bone(f"{side} foot", f"{side} toes")
        foot = self._our(side, "Foot")
        ours = self._scale * self.clip.body.rest_offsets[foot]
        theirs = rotate(inverse(heading(self.rig)), ours)
        sole = self._scale * self.clip.body.radii[foot]
        return np.asarray(theirs * _LEVEL + (sole - self._ankle_height(side)) * _UP)

    def shortage(self, side: str, goal: Array) -> Array:
        """Return by how much the hips are too high for a leg [m], shape (T,)."""
        way = self.positions[:, self.rig.joint(f"{side} thigh")] - goal
        reach = self.rig.limb(side, *_LEG).sum()
        level = np.sum((way * _LEVEL) ** 2, axis=1)
        height = np.sqrt(np.maximum(reach**2 - level, 0.0))
        return np.asarray(np.maximum(way[:, 1] - height, 0.0))

    def bend(self, side: str, limb: _Limb, goal: Array) -> None:
        """Turn the two bones of a limb so that it ends at a goal [m], shape (T, 3)."""
        parts = [f"{side} {part}" for part in limb]
        upper, lower = self.rig.joint(parts[0]), self.rig.joint(parts[1])
        start = self.positions[:, upper]
        lengths = self.rig.limb(side, *limb)
        middle, end = bent_limb(start, goal, self._toward(side, limb), lengths)
        for joint, bone, now in (
            (upper, self.rig.bone(parts[0], parts[1]), middle - start),
            (lower, self.rig.bone(parts[1], parts[2]), end - middle),
        ):
            turn = self.turns[joint]
            self.turns[joint] = multiply(between(rotate(turn, bone), now), turn)

    def _toward(self, side: str, limb: _Limb) -> Array:
        """Return the direction in which a limb bends, shape (T, 3)."""
        first, middle, last = (self._our(side, joint) for joint in _JOINTS[limb])
        positions = self.clip.positions
        bone = positions[:, middle] - positions[:, first]
        line = positions[:, last] - positions[:, first]
        share = np.sum(bone * line, axis=1) / np.maximum(np.sum(line**2, axis=1), 1e-12)
        segment = segment_of(self.clip.skeleton, f"{side} {limb[0]}")
        hinge = rotate(self.clip.rotations[:, segment], _BENDS[limb])
        aside = bone - share[:, None] * line
        least = _HINGE * self._our_length(side, limb)
        bent = np.linalg.norm(aside, axis=1)
        bent += np.maximum(np.sum(aside * hinge, axis=1), 0.0)
        straight = smooth_step(2.0 - bent / least)
        return np.asarray(aside + least * straight[:, None] * hinge)


def segment_of(skeleton: Skeleton, part: str) -> int:
    """Return the index of the segment, by the joint it ends at, that turns a part."""
    side, _, limb = part.partition(" ")
    if limb:
        return skeleton.index(f"{_SEGMENTS[limb]}{side.capitalize()}")
    head, chest = skeleton.index("Head"), skeleton.girdle
    neck = head if skeleton.parents[head] == chest else skeleton.parents[head]
    trunk = {"pelvis": skeleton.root, "spine": chest, "neck": neck, "head": head}
    return trunk[part]


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
        return multiply(between(_LEVEL * theirs, _LEVEL * ours), facing)
    return facing
