"""Rest poses of other skeletons, and the parts of the body in them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, unit, wxyz_from_matrix

from .rig_map import CHAINS, NEXT, OPTIONAL, PARTS, SIDES, WORDS, Bone, RigMap, listed

_ON_FLOOR = 0.1
"""Largest height of the lowest joint above y = 0, in lengths of a leg, at which y = 0
is the floor. A guess; if the root is at the origin, the floor is a leg below it."""
_SHORTEST = 1e-3  # of the leg's length: shorter limbs have no direction
_TRUNK = {"spine", "neck", "head"} | {
    f"{side} {part}" for side in SIDES for part in ("clavicle", "upper arm")
}
_LEGS = (0.01, 100.0)  # m: plausible lengths of an animated character's legs


@dataclass(frozen=True, eq=False)
class RestPose:
    """Joints of a skeleton in T- or A-pose, with any heading, parents first."""

    names: tuple[str, ...]
    parents: tuple[int, ...]  # index of each joint's parent, -1 for the root
    positions: Array  # positions [m], y up, shape (N, 3)
    axes: Array | None = None
    """World rotation of each joint's own axes, wxyz, shape (N, 4); None: identity."""
    lowest: float | None = None
    """Height [m] of the lowest point, if the file has more than joints."""
    source: str = "rig"
    axes_in_bvh: bool = False
    """True if BVH has these axes too; otherwise its joints have those of the world."""

    def __len__(self) -> int:
        return len(self.names)


class Twist(NamedTuple):
    """What turns a twist bone, which spreads a limb's twist evenly along a segment.

    The skin of an upper arm must not twist at the shoulder, but only toward the elbow,
    and that of a forearm must twist with the hand at the wrist. So a twist bone turns
    about its segment by a share of the twist.
    """

    limb: int  # index of the joint whose segment it is on
    joint: int  # index of the joint whose twist about that segment it shares
    above: int  # index of the turned joint against which that joint twists
    axis: Array  # direction of the segment in the rest pose, unit length, (3,)
    share: float  # share of the twist by which it is turned against the segment


@dataclass(frozen=True, eq=False)
class TargetRig:
    """A rest pose with the parts of the body in it."""

    rest: RestPose
    parts: dict[str, tuple[int, ...]]
    """Joints that each part turns, parents before children."""
    floor: float  # height of the floor [m]
    twists: dict[int, Twist] = field(default_factory=dict)
    """What turns each twist bone, by index of its joint."""
    followed: dict[int, int] = field(default_factory=dict)
    """The joint that each IK bone follows, by index of the IK bone."""

    def joint(self, part: str) -> int:
        """Return the first joint that a part turns."""
        return self.parts[part][0]

    def bone(self, start: str, end: str) -> Array:
        """Return the vector [m] from one part's joint to another's in the rest pose."""
        positions = self.rest.positions
        return np.asarray(positions[self.joint(end)] - positions[self.joint(start)])

    def limb(self, side: str, first: str, second: str, end: str) -> Array:
        """Return the lengths [m] of the two bones of a limb, shape (2,)."""
        parts = [f"{side} {part}" for part in (first, second, end)]
        bones = [self.bone(*ends) for ends in pairwise(parts)]
        return np.asarray(np.linalg.norm(bones, axis=1))

    @property
    def leg_length(self) -> float:
        """Length [m] of thigh and shin, mean of both sides."""
        legs = [self.limb(side, "thigh", "shin", "foot").sum() for side in SIDES]
        return float(np.mean(legs))


def built_rig(rig_map: RigMap, body: Body) -> TargetRig:
    """Return the skeleton that a map describes, in a person's size.

    Lengths of limbs, widths of hips and shoulders and the distance between them are the
    person's; the rest scales with the stature. The soles are at y = 0. Raises an
    InputError if the map lacks offsets.
    """
    bones = [b for b in rig_map.bones if b.offset or b.twist_of or b.follows]
    names = tuple(bone.name for bone in bones)
    for bone in bones:
        if bone.parent is not None and bone.parent not in names:
            raise InputError(
                f"{rig_map.name}: bone {bone.parent!r} has no offset, but it is the "
                f"parent of {bone.name!r}; add one"
            )
    parents = [-1 if b.parent is None else names.index(b.parent) for b in bones]
    for part in PARTS:
        if part not in OPTIONAL and not any(b.part == part for b in bones):
            raise InputError(
                f"{rig_map.name}: the bone turned_by {part!r} has no offset; add one, "
                "or read the skeleton from a file"
            )
    above = [bones[n] for n in parents]
    offsets = np.array([_offset(*two, body) for two in zip(bones, above, strict=True)])
    for n, bone in enumerate(bones):
        if bone.twist_of:
            end = NEXT[bones[parents[n]].part or ""]
            offsets[n] = bone.at * offsets[[b.part for b in bones].index(end)]
    positions = chained(offsets, parents)
    rest = RestPose(names, tuple(parents), positions, source=rig_map.name)
    rig = matched_rig(rig_map, rest, body)
    for part in _TRUNK & rig.parts.keys():
        offsets[list(rig.parts[part])] *= _trunk_scale(rig, body)
    positions = chained(offsets, parents)
    joints, height = _lowest(rig, body)
    moving = [rig.joint("pelvis")]  # and its descendants
    for n in range(moving[0] + 1, len(rest)):
        if parents[n] in moving:
            moving.append(n)
    positions[moving, 1] += height - positions[joints, 1].min()
    for n, joint in rig.followed.items():
        positions[n] = positions[joint]
    rest = replace(rest, positions=positions, axes_in_bvh=rig_map.axes_in_bvh)
    names = tuple(rig_map.prefix + name for name in names)
    rest = replace(rest, names=names, axes=_axes(bones, rest, rig.followed))
    return replace(rig, rest=rest, floor=0.0)


def chained(offsets: Array, parents: Sequence[int]) -> Array:
    """Return positions (N, 3) from offsets from parents (-1: none), parents first."""
    positions = offsets.copy()
    for n, parent in enumerate(parents):
        positions[n] += positions[parent] if parent >= 0 else 0.0
    return positions


def _trunk_scale(rig: TargetRig, body: Body) -> Array:
    """Return the size of a person's trunk relative to the rig's, shape (3,)."""
    rest, sides = body.rest_positions, body.skeleton.sides
    hips, shoulders = rest[sides("Hip")], rest[sides("Shoulder")]
    width = rig.bone("right upper arm", "left upper arm")[0]
    up, down = (rig.bone("pelvis", f"left {p}")[1] for p in ("upper arm", "thigh"))
    height = (shoulders - hips)[:, 1].mean() + down
    sizes = [np.ptp(shoulders[:, 0]), height, 1.0]
    scale = sizes / np.maximum([width, up, 1.0], 1e-9)
    return np.where((scale > 0.5) & (scale < 2.0), scale, 1.0)


def _axes(bones: list[Bone], rest: RestPose, followed: dict[int, int]) -> Array | None:
    """Return the world rotation of each bone's axes, wxyz, (N, 4); None: identity."""
    if not any(bone.axes for bone in bones):
        return None
    rotations = np.tile(IDENTITY, (len(bones), 1))
    for n, bone in enumerate(bones):
        if bone.twist_of:
            rotations[n] = rotations[rest.parents[n]]
        if n in followed:
            rotations[n] = rotations[followed[n]]
        if bone.axes is None:
            continue
        # A bone points to its first child; the last of a chain continues its parent.
        tip = rest.parents.index(n) if n in rest.parents else n
        along = rest.positions[tip] - rest.positions[rest.parents[tip]]
        matrix = np.zeros((3, 3))
        for axis, word in bone.axes:
            direction = along
            if word != "on":
                numbers = WORDS.get(word) or [float(x) for x in word.split()]
                direction = np.array(numbers)
            direction = direction * (-1.0 if axis[0] == "-" else 1.0)
            # The second axis is perpendicular to the first.
            direction = direction - matrix @ (direction @ matrix)
            length = float(np.linalg.norm(direction))
            if length < _SHORTEST:
                raise InputError(
                    f"{rest.source}: bone {bone.name!r}: its axis {axis} has no "
                    f"direction; {word} has no length or is parallel to the other axis"
                )
            matrix[:, "xyz".index(axis[-1])] = direction / length
        (free,) = {0, 1, 2} - {"xyz".index(axis[-1]) for axis, _ in bone.axes}
        matrix[:, free] = np.cross(matrix[:, free - 2], matrix[:, free - 1])
        rotations[n] = wxyz_from_matrix(matrix)
    return rotations


def matched_rig(rig_map: RigMap, rest: RestPose, body: Body) -> TargetRig:
    """Return a skeleton whose parts are found by the names of a map.

    If toes (or ankles) are just above y = 0, this is the floor. Otherwise the floor is
    as far below them as the person's soles, or at the file's lowest point if that is
    lower. Raises an InputError unless the skeleton has one root and all joints of the
    map, without ambiguity, in the right hierarchy and in different places.
    """
    roots = [rest.names[n] for n, parent in enumerate(rest.parents) if parent < 0]
    if len(roots) != 1:
        raise InputError(
            f"{rest.source}: has {len(roots)} roots ({listed(roots)}), expected one; "
            "parent them to one joint"
        )
    rig = TargetRig(rest, _joints_of_parts(rig_map, rest), 0.0)
    _check_chains(rest, rig.parts)
    _check_lengths(rig)
    rig = replace(rig, twists=_twists(rig_map, rig), followed=_followed(rig_map, rest))
    joints, height = _lowest(rig, body)
    lowest = float(rest.positions[joints, 1].min())
    if 0.0 <= lowest <= _ON_FLOOR * rig.leg_length:
        return rig
    legs = [body.skeleton.index(f"{j}Left") for j in ("Knee", "Ankle")]
    floor = lowest - height * rig.leg_length / float(body.lengths[legs].sum())
    return replace(rig, floor=floor if rest.lowest is None else min(floor, rest.lowest))


def _twists(rig_map: RigMap, rig: TargetRig) -> dict[int, Twist]:
    """Return what turns the twist bones of a map that the skeleton has."""
    names, parents = [rig_map.plain(name) for name in rig.rest.names], rig.rest.parents
    part_of = {bone.name: bone.part for bone in rig_map.bones}
    turned = {joint for joints in rig.parts.values() for joint in joints}
    twists = {}
    for bone in rig_map.bones:
        name, limb = rig_map.plain(bone.name), part_of.get(bone.parent or "") or ""
        if bone.twist_of is None or name not in names:
            continue
        joint = rig.joint(bone.twist_of)
        above = parents[joint]
        while above not in turned:
            above = parents[above]
        axis = unit(rig.bone(limb, NEXT[limb]))
        share = bone.at - 1.0 if bone.twist_of == limb else bone.at
        twists[names.index(name)] = Twist(rig.joint(limb), joint, above, axis, share)
    return twists


def _followed(rig_map: RigMap, rest: RestPose) -> dict[int, int]:
    """Return the joint that each IK bone of a map follows, where both are there."""
    joints = {rig_map.plain(name): n for n, name in enumerate(rest.names)}
    pairs = [(b.name, b.follows) for b in rig_map.bones if b.follows is not None]
    found = [tuple(joints.get(rig_map.plain(name)) for name in pair) for pair in pairs]
    return {n: joint for n, joint in found if n is not None and joint is not None}


def _lowest(rig: TargetRig, body: Body) -> tuple[list[int], float]:
    """Return a rig's toes (or else ankles) and the height [m] of the person's."""
    toes = [rig.joint(f"{s} toes") for s in SIDES if f"{s} toes" in rig.parts]
    if toes:
        return toes, float(body.radii[body.skeleton.index("FootLeft")])
    ankles = [rig.joint(f"{side} foot") for side in SIDES]
    return ankles, float(body.rest_positions[body.skeleton.index("AnkleLeft"), 1])


def _offset(bone: Bone, parent: Bone, body: Body) -> Array:
    """Return a bone's offset from its parent [m], shape (3,)."""
    share, skeleton = np.array(bone.offset or (0.0, 0.0, 0.0)), body.skeleton
    segment = {"lower arm": "Elbow", "hand": "Wrist", "shin": "Knee", "foot": "Ankle"}
    side, _, part = (bone.part or "").partition(" ")
    if part == "thigh":  # hips as wide as the person's
        width = np.ptp(body.rest_positions[skeleton.hips, 0])
        return np.array([np.sign(share[0]) * width / 2, *share[1:] * body.height])
    if part == "toes":  # ankles as high and feet as long as the person's
        offset = share * [1.0, 0.0, 1.0]
        foot, ankle = (skeleton.index(f"{j}Left") for j in ("Foot", "Ankle"))
        x, _, z = body.rest_offsets[foot]
        offset *= float(np.hypot(x, z)) / max(float(np.linalg.norm(offset)), 1e-9)
        offset[1] = body.radii[foot] - body.rest_positions[ankle, 1]
        return np.asarray(offset)
    if part not in segment or parent.part != CHAINS[f"{side} {part}"]:
        return share * body.height
    length = body.lengths[skeleton.index(f"{segment[part]}{side.capitalize()}")]
    return np.asarray(length * share / max(float(np.linalg.norm(share)), 1e-9))


def _joints_of_parts(rig_map: RigMap, rest: RestPose) -> dict[str, tuple[int, ...]]:
    plain = [rig_map.plain(name) for name in rest.names]
    parts: dict[str, tuple[int, ...]] = {}
    missing = []
    for part in PARTS:
        names, joints = [bone.name for bone in rig_map.of(part)], list[int]()
        for name in names:
            matches = [n for n, p in enumerate(plain) if p == rig_map.plain(name)]
            if len(matches) > 1:
                raise InputError(
                    f"{rest.source}: has {len(matches)} joints {name!r}, expected one"
                )
            joints += matches
        if joints:
            parts[part] = tuple(sorted(joints))
        elif part not in OPTIONAL:
            missing.append(" or ".join(names))
    if missing:
        raise InputError(
            f"{rest.source}: no joint {listed(missing)}, which {rig_map.name} has; "
            f"found {listed(rest.names)}; choose the rig with these names, or give a "
            "map (.toml)"
        )
    return parts


def _check_chains(rest: RestPose, parts: dict[str, tuple[int, ...]]) -> None:
    of = {joint: part for part, joints in parts.items() for joint in joints}
    for joint, part in of.items():
        above = rest.parents[joint]
        chain = CHAINS.get(part, "")
        limb = chain not in ("", "pelvis")
        while above >= 0 and (of.get(above) != chain) and not (limb and above in of):
            above = rest.parents[above]
        if chain and (above < 0 or of.get(above) != chain):
            raise InputError(
                f"{rest.source}: joint {rest.names[joint]!r} ({part}) must descend "
                f"from {rest.names[parts[chain][0]]!r}"
            )


def _check_lengths(rig: TargetRig) -> None:
    if not _LEGS[0] < rig.leg_length < _LEGS[1]:
        raise InputError(
            f"{rig.rest.source}: the legs are {rig.leg_length:g} m long, expected "
            f"{_LEGS[0]:g} to {_LEGS[1]:g}; correct the unit"
        )
    for part, above in CHAINS.items():
        if above == "pelvis" or part not in rig.parts:
            continue
        if not np.linalg.norm(rig.bone(above, part)) > _SHORTEST * rig.leg_length:
            start, end = (rig.rest.names[rig.joint(p)] for p in (above, part))
            raise InputError(
                f"{rig.rest.source}: {start!r} and {end!r} are in one place; the bone "
                "between them needs a length"
            )
