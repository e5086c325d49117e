"""A skeleton in its rest pose, whatever its names, and the parts of the body in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, wxyz_from_matrix

from .rig_map import CHAINS, OPTIONAL, PARTS, SIDES, WORDS, MapBone, RigMap, listed

_ON_FLOOR = 0.1
"""Lengths of a leg: a lowest joint that is no higher over y = 0 stands on that floor.
A guess; rigs whose root is at the origin have it a whole leg below."""
_SHORTEST = 1e-3  # of the leg's length: limbs that are shorter have no direction
_TRUNK = {"spine", "neck", "head"} | {
    f"{side} {part}" for side in SIDES for part in ("clavicle", "upper arm")
}
_LEGS = (0.01, 100.0)  # m, of what somebody animates


@dataclass(frozen=True, eq=False)
class RestPose:
    """Joints of a skeleton that stands in T- or A-pose, in whatever heading.

    Every parent is before its children; the root's is -1. Positions [m] have y up,
    shape (N, 3).
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    positions: Array
    axes: Array | None = None
    """World rotation of each joint's own axes, wxyz, shape (N, 4); None: identity."""
    lowest: float | None = None
    """Height [m] of the lowest point if the file knows more than joints."""
    source: str = "rig"
    axes_in_bvh: bool = False
    """Whether BVH has these axes too; else its joints have those of the world."""

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class TargetRig:
    """A rest pose whose parts of the body are known, and the height of its floor [m].

    Each part that it has turns joints, from the root on.
    """

    rest: RestPose
    parts: dict[str, tuple[int, ...]]
    floor: float

    def joint(self, part: str) -> int:
        """Return the joint that a part turns, its first."""
        return self.parts[part][0]

    def bone(self, start: str, end: str) -> Array:
        """Return the vector [m] from one part's joint to another's in the rest pose."""
        positions = self.rest.positions
        return np.asarray(positions[self.joint(end)] - positions[self.joint(start)])

    def limb(self, side: str, first: str, second: str, end: str) -> Array:
        """Return the lengths [m] of the two bones of a limb, shape (2,)."""
        ends = [f"{side} {part}" for part in (first, second, end)]
        bones = [self.bone(ends[0], ends[1]), self.bone(ends[1], ends[2])]
        return np.asarray(np.linalg.norm(bones, axis=1))

    @property
    def leg_length(self) -> float:
        """Length [m] of thigh and shin, mean of both sides."""
        legs = [self.limb(side, "thigh", "shin", "foot").sum() for side in SIDES]
        return float(np.mean(legs))


def built_rig(rig_map: RigMap, body: Body) -> TargetRig:
    """Return the skeleton that a map describes, in a person's size.

    Limbs have the person's lengths, hips and shoulders are as wide and as far from each
    other as the person's, the rest is scaled to the stature. The soles are on y = 0.
    Raises InputError if the map lacks offsets.
    """
    bones = [bone for bone in rig_map.bones if bone.offset is not None]
    names = tuple(bone.name for bone in bones)
    for bone in bones:
        if bone.parent is not None and bone.parent not in names:
            raise InputError(
                f"{rig_map.name}: bone {bone.parent!r} has no offset, but "
                f"{bone.name!r} hangs on it; give it one"
            )
    parents = [-1 if b.parent is None else names.index(b.parent) for b in bones]
    for part in PARTS:
        if part not in OPTIONAL and not any(b.part == part for b in bones):
            raise InputError(
                f"{rig_map.name}: the bone turned_by {part!r} has no offset; give it "
                "one, or take the skeleton from a file of it"
            )
    above = [bones[n] for n in parents]
    offsets = np.array([_offset(*two, body) for two in zip(bones, above, strict=True)])
    places = _placed(offsets, parents)
    rest = RestPose(names, tuple(parents), places, source=rig_map.name)
    rig = matched_rig(rig_map, rest, body)
    for part in _TRUNK & rig.parts.keys():
        offsets[list(rig.parts[part])] *= _trunk(rig, body)
    positions = _placed(offsets, parents)
    joints, height = _lowest(rig, body)
    moving = [rig.joint("pelvis")]  # and all that hangs on it
    for n in range(moving[0] + 1, len(rest)):
        if parents[n] in moving:
            moving.append(n)
    positions[moving, 1] += height - positions[joints, 1].min()
    full = tuple(rig_map.prefix + name for name in names)
    rest = replace(rest, positions=positions)
    axes, in_bvh = _axes(bones, rest), rig_map.axes_in_bvh
    rest = replace(rest, names=full, axes=axes, axes_in_bvh=in_bvh)
    return TargetRig(rest, rig.parts, 0.0)


def _placed(offsets: Array, parents: list[int]) -> Array:
    places = offsets.copy()
    for n, parent in enumerate(parents):
        places[n] += places[parent] if parent >= 0 else 0.0
    return places


def _trunk(rig: TargetRig, body: Body) -> Array:
    """Return how much wider and taller than the rig's a person's trunk is, (3,)."""
    hips, shoulders = (
        body.rest_positions[body.skeleton.sides(joint)] for joint in ("Hip", "Shoulder")
    )
    width = rig.bone("right upper arm", "left upper arm")[0]
    up, down = (rig.bone("pelvis", f"left {p}")[1] for p in ("upper arm", "thigh"))
    tall = (shoulders - hips)[:, 1].mean() + down
    factors = [np.ptp(shoulders[:, 0]), tall, 1.0] / np.maximum([width, up, 1.0], 1e-9)
    return np.where((factors > 0.5) & (factors < 2.0), factors, 1.0)


def _axes(bones: list[MapBone], rest: RestPose) -> Array | None:
    """Return the world rotation of each bone's axes, wxyz, (N, 4); None: identity."""
    if not any(bone.axes for bone in bones):
        return None
    found = np.tile(IDENTITY, (len(bones), 1))
    for n, bone in enumerate(bones):
        if bone.axes is None:
            continue
        # On to what hangs on it, from the last bone as the one before goes on.
        tip = rest.parents.index(n) if n in rest.parents else n
        bone_on = rest.positions[tip] - rest.positions[rest.parents[tip]]
        matrix = np.zeros((3, 3))
        for axis, word in bone.axes:
            way = bone_on
            if word != "on":
                way = np.array(WORDS.get(word) or [float(n) for n in word.split()])
            way = way * (-1.0 if axis[0] == "-" else 1.0)
            way = way - matrix @ (way @ matrix)  # square to the first
            length = float(np.linalg.norm(way))
            if length < _SHORTEST:
                raise InputError(
                    f"{rest.source}: bone {bone.name!r}: its axis {axis} has no "
                    f"direction; {word} is no length, or where the other axis points"
                )
            matrix[:, "xyz".index(axis[-1])] = way / length
        (free,) = {0, 1, 2} - {"xyz".index(axis[-1]) for axis, _ in bone.axes}
        before, after = matrix[:, free - 2], matrix[:, free - 1]
        matrix[:, free] = np.cross(before, after)
        found[n] = wxyz_from_matrix(matrix)
    return found


def matched_rig(rig_map: RigMap, rest: RestPose, body: Body) -> TargetRig:
    """Return a skeleton with its parts found by the names of a map.

    The floor is y = 0 where toes (or ankles) are just over it. Otherwise it is as far
    under them as the person's soles, or the file's lowest point if that is lower.
    Raises an InputError if the skeleton has not one root, or joints are missing,
    ambiguous, elsewhere, or two of them in one place.
    """
    roots = [rest.names[n] for n, parent in enumerate(rest.parents) if parent < 0]
    if len(roots) != 1:
        raise InputError(
            f"{rest.source}: has {len(roots)} roots ({listed(roots)}), expected one; "
            "hang them under one joint"
        )
    rig = TargetRig(rest, _found(rig_map, rest), 0.0)
    _check_chains(rest, rig.parts)
    _check_lengths(rig)
    joints, height = _lowest(rig, body)
    lowest = float(rest.positions[joints, 1].min())
    if 0.0 <= lowest <= _ON_FLOOR * rig.leg_length:
        return rig
    legs = [body.skeleton.index(f"{j}Left") for j in ("Knee", "Ankle")]
    floor = lowest - height * rig.leg_length / float(body.lengths[legs].sum())
    return replace(rig, floor=floor if rest.lowest is None else min(floor, rest.lowest))


def _lowest(rig: TargetRig, body: Body) -> tuple[list[int], float]:
    """Return a rig's toes and their height [m] over a person's soles.

    Of a rig without toes, its ankles.
    """
    toes = [rig.joint(f"{s} toes") for s in SIDES if f"{s} toes" in rig.parts]
    if toes:
        return toes, float(body.radii[body.skeleton.index("FootLeft")])
    ankles = [rig.joint(f"{side} foot") for side in SIDES]
    return ankles, float(body.rest_positions[body.skeleton.index("AnkleLeft"), 1])


def _offset(bone: MapBone, parent: MapBone, body: Body) -> Array:
    """Return a bone's offset from its parent [m], shape (3,)."""
    share = np.array(bone.offset)
    segment = {"lower arm": "Elbow", "hand": "Wrist", "shin": "Knee", "foot": "Ankle"}
    side, _, part = (bone.part or "").partition(" ")
    if part == "thigh":  # hips as wide as the person's
        hips = body.rest_positions[body.skeleton.hips, 0]
        return np.array(
            [np.sign(share[0]) * np.ptp(hips) / 2, *share[1:] * body.height]
        )
    if part == "toes":  # ankles as high, feet as long as the person's
        skeleton, way = body.skeleton, share * [1.0, 0.0, 1.0]
        foot, ankle = (skeleton.index(f"{j}Left") for j in ("Foot", "Ankle"))
        x, _, z = body.rest_offsets[foot]
        way *= float(np.hypot(x, z)) / max(float(np.linalg.norm(way)), 1e-9)
        way[1] = body.radii[foot] - body.rest_positions[ankle, 1]
        return np.asarray(way)
    if part not in segment or parent.part != CHAINS[f"{side} {part}"]:
        return share * body.height
    length = body.lengths[body.skeleton.index(f"{segment[part]}{side.capitalize()}")]
    return np.asarray(length * share / max(float(np.linalg.norm(share)), 1e-9))


def _found(rig_map: RigMap, rest: RestPose) -> dict[str, tuple[int, ...]]:
    plain = [rig_map.plain(name) for name in rest.names]
    parts: dict[str, list[int]] = {}
    missing = []
    for part in PARTS:
        wanted = [bone.name for bone in rig_map.of(part)]
        for name in wanted:
            places = [n for n, p in enumerate(plain) if p == rig_map.plain(name)]
            if len(places) > 1:
                raise InputError(
                    f"{rest.source}: has {len(places)} joints {name!r}, not one"
                )
            parts.setdefault(part, []).extend(places)
        if not parts.get(part) and part not in OPTIONAL:
            missing.append(" or ".join(wanted))
    if missing:
        raise InputError(
            f"{rest.source}: no joint {listed(missing)}, which {rig_map.name} has; "
            f"found {listed(rest.names)}; give the rig of these names or a map "
            "(.toml)"
        )
    return {part: tuple(sorted(places)) for part, places in parts.items() if places}


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
                f"{rest.source}: joint {rest.names[joint]!r} does not hang on "
                f"{rest.names[parts[chain][0]]!r}; a {part} does"
            )


def _check_lengths(rig: TargetRig) -> None:
    if not _LEGS[0] < rig.leg_length < _LEGS[1]:
        raise InputError(
            f"{rig.rest.source}: the legs are {rig.leg_length:g} m long, expected "
            f"{_LEGS[0]:g} to {_LEGS[1]:g}; correct the unit"
        )
    least = _SHORTEST * rig.leg_length
    for part, above in CHAINS.items():
        if above == "pelvis" or part not in rig.parts:
            continue
        if not np.linalg.norm(rig.bone(above, part)) > least:
            start, end = (rig.rest.names[rig.joint(p)] for p in (above, part))
            raise InputError(
                f"{rig.rest.source}: {start!r} and {end!r} are in one place; a bone "
                "between them needs a length"
            )
