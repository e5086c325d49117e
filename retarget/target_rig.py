"""A skeleton in its rest pose, whatever its names, and the parts of the body in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array

from .rig_map import CHAINS, OPTIONAL, PARTS, SIDES, MapBone, RigMap, listed

_ON_FLOOR = 0.1
"""Lengths of a leg: a lowest joint that is no higher over y = 0 stands on that floor.
A guess; rigs whose root is at the origin have it a whole leg below."""
_SHORTEST = 1e-3  # of the leg's length: limbs that are shorter have no direction
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

    Thighs, shins and arms have the person's lengths, the rest of the skeleton is scaled
    to the stature. The soles are on y = 0. Raises InputError if the map lacks offsets.
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
    positions = np.zeros((len(bones), 3))
    for n, bone in enumerate(bones):
        positions[n] = _offset(bone, bones[parents[n]], body)
        if parents[n] >= 0:
            positions[n] += positions[parents[n]]
    rest = RestPose(names, tuple(parents), positions, source=rig_map.name)
    rig = matched_rig(rig_map, rest, body)
    joints, height = _lowest(rig, body)
    moving = [rig.joint("pelvis")]  # and all that hangs on it
    for n in range(moving[0] + 1, len(rest)):
        if parents[n] in moving:
            moving.append(n)
    positions[moving, 1] += height - positions[joints, 1].min()
    full = tuple(rig_map.prefix + name for name in names)
    return TargetRig(replace(rest, names=full), rig.parts, 0.0)


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
