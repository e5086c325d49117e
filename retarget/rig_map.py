"""Maps between our joints and other skeletons, in TOML files.

Maps in ``rigs``, or a user's own, describe skeletons on which clips are written. Each
bone, parents before children, has these fields:

turned_by: The part of the body (PARTS) that turns it; without, it turns with its
    parent.
offset: Position relative to the parent in the rest pose, as shares of stature; x to the
    left, y up, z ahead. Limbs, feet and the widths of hips and shoulders take the
    person's size, so only their directions and proportions count.
axes: Directions of two of the bone's own axes in the rest pose, the second as close as
    possible: a word (WORDS), three numbers, or ``on``, which points along the bone to
    its first child, or continues from its parent at the end of a chain. ``axes`` at the
    top of the file is for all bones that have none.
twist_of: Makes it a twist bone, which has only this field, ``parent`` and ``at``: the
    part whose twist about the parent's segment it shares. This is the part that turns
    the parent, or the next one along the limb.
at: Its position on that segment, 0 at the start and 1 at the end, and its share of the
    twist, where the start of the segment has none.
follows: Makes it an IK bone, which has only this field and ``parent``: the bone that it
    is always in the place of, turned the same way.

Maps in ``source_rigs`` describe skeletons from which motion is read; ``title`` says
what their names are. Joints of the trunk are named as in Kinect v2. Limbs have only a
left side: names on the right begin with Right, R or r in place of Left, L or l.

at: The Kinect joint is at the mean of these joints (or landmarks).
or: Where it is if those are missing, the best choice first.
optional: True if it may be missing.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Sequence, Set
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import shown

_HERE = Path(__file__).parent
RIGS = tuple(sorted(path.stem for path in (_HERE / "rigs").glob("*.toml")))
"""Names of the built-in maps."""

SIDES = ("left", "right")
_ARM, _LEG = ("upper arm", "lower arm", "hand"), ("thigh", "shin", "foot", "toes")
CHAINS = {
    f"{side} {part}": f"{side} {limb[k - 1]}" if k else "pelvis"
    for side in SIDES
    for limb in (("clavicle",), _ARM, _LEG)
    for k, part in enumerate(limb)
} | {"spine": "pelvis", "neck": "pelvis", "head": "pelvis"}
"""Parent of each part of the body."""
PARTS = ("pelvis", *CHAINS)  # parts of the body that turn bones
OPTIONAL = {"neck", *(f"{s} {part}" for s in SIDES for part in ("clavicle", "toes"))}
"""Parts that a skeleton may lack."""
_SEVERAL = ("spine", "neck")
_FIELDS = {"parent", "turned_by", "offset", "axes", "twist_of", "at", "follows"}
_OF_TWISTS = {"parent", "twist_of", "at"}
_OF_IK_BONES = {"parent", "follows"}
NEXT = {
    above: part
    for part, above in CHAINS.items()
    if above != "pelvis" and not part.endswith("toes")
}
"""The next part along a limb, for each part between two joints."""
WORDS = {
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "up": (0.0, 1.0, 0.0),
    "down": (0.0, -1.0, 0.0),
    "ahead": (0.0, 0.0, 1.0),
    "back": (0.0, 0.0, -1.0),
}
"""Words for the directions of a bone's axes in the rest pose."""
_KINECT_V1 = {  # its names of joints in Kinect v2's trunk
    "SpineBase": "HipCenter",
    "SpineMid": "Spine",
    "SpineShoulder": "ShoulderCenter",
}
_NUMBER = r"-?[01]?\.?\d{1,9}"
_ONE_AXIS = rf"(-?[xyz]) (on|{'|'.join(WORDS)}|{_NUMBER} {_NUMBER} {_NUMBER})"
_AXES = re.compile(f"{_ONE_AXIS}, {_ONE_AXIS}")
Axes = tuple[tuple[str, str], tuple[str, str]]
"""Two axes, such as ``x`` or ``-x``, and their directions."""


@dataclass(frozen=True)
class Bone:
    """A bone of another skeleton, which starts at the joint of its name.

    The other fields are those of the file, None where a bone has none; ``part`` is its
    ``turned_by``. Without an offset it is only looked for in files, but not built.
    """

    name: str
    parent: str | None
    part: str | None
    offset: tuple[float, float, float] | None
    axes: Axes | None = None
    twist_of: str | None = None
    at: float = 0.0
    follows: str | None = None


@dataclass(frozen=True)
class RigMap:
    """Names, hierarchy and rest pose of another skeleton, parents before children."""

    name: str
    prefix: str  # prefix of all names, which some files omit
    bones: tuple[Bone, ...]
    axes_in_bvh: bool = False
    """True if motion in BVH, which has no rest rotations, is in the bones' axes."""

    def of(self, part: str) -> list[Bone]:
        """Return the bones that a part turns, parents before children."""
        return [bone for bone in self.bones if bone.part == part]

    def plain(self, name: str) -> str:
        """Return a joint's name without namespace and prefix, in lower case."""
        bare = name.rpartition(":")[2].strip().casefold()
        stem = re.escape(self.prefix.rstrip(":_").casefold())
        return re.sub(rf"^{stem}\d*[:_]", "", bare) if stem else bare


@cache
def load_rig_map(rig: str) -> RigMap:
    """Return the map of one of RIGS."""
    return rig_map_of(_embedded("rigs", rig), rig)


def _embedded(folder: str, name: str) -> dict[str, Any]:
    return tomllib.loads((_HERE / folder / f"{name}.toml").read_text(encoding="utf-8"))


def rig_map_of(table: dict[str, Any], source: str) -> RigMap:
    """Return the map in the table of a TOML file, or raise an InputError."""
    rows: Any = table.get("bones")
    prefix, in_bvh = table.get("prefix", ""), table.get("axes_in_bvh", False)
    known, wrong = ("prefix", "axes", "axes_in_bvh", "bones"), ""
    if not isinstance(rows, dict) or not isinstance(prefix, str):
        wrong = "expected a table [bones] with a row per joint and, optionally, a text "
        wrong += "'prefix'"
    elif unknown := sorted(set(table) - set(known)):
        wrong = f"unknown {unknown[0]!r}; expected {', '.join(known)}"
    elif not isinstance(in_bvh, bool):
        wrong = f"axes_in_bvh is {shown(in_bvh)}, expected true or false"
    if wrong:
        raise InputError(f"{source}: {wrong}")
    axes = _axes(table.get("axes"), source)
    bones = tuple(_bone(name, row, axes, source) for name, row in rows.items())
    _check(bones, source)
    return RigMap(source, prefix, bones, in_bvh)


def _axes(words: Any, where: str) -> Axes | None:
    if words is None:
        return None
    match = _AXES.fullmatch(words) if isinstance(words, str) else None
    if match is None or match[1][-1] == match[3][-1]:
        raise InputError(
            f"{where}: axes are {shown(words)}, expected two such as 'y on, -z back'; "
            f"directions are on, {', '.join(WORDS)}, or three numbers like 0 -0.6 0.8"
        )
    return (match[1], match[2]), (match[3], match[4])


def _bone(name: str, row: Any, axes: Axes | None, source: str) -> Bone:
    where, wrong = f"{source}: bone {shown(name)}", ""
    if not isinstance(row, dict) or not _FIELDS.issuperset(row):
        raise InputError(f"{where}: expected fields {', '.join(sorted(_FIELDS))}")
    part, parent, offset = (row.get(k) for k in ("turned_by", "parent", "offset"))
    twist_of, at, follows = (row.get(k) for k in ("twist_of", "at", "follows"))
    if part is not None and part not in PARTS:
        wrong = f"unknown turned_by {shown(part)}; expected one of {', '.join(PARTS)}"
    elif parent is not None and not isinstance(parent, str):
        wrong = f"parent is {shown(parent)}, expected a bone's name"
    elif "twist_of" in row or "at" in row:
        known = isinstance(twist_of, str) and type(at) in (int, float)
        if not known or set(row) != _OF_TWISTS or not 0.0 <= (at or 0.0) <= 1.0:
            wrong = "a twist bone has only a parent, twist_of, a part of the body, and "
            wrong += "at, a number from 0 to 1 along the parent's segment"
        axes = None
    elif "follows" in row:
        if not isinstance(follows, str) or set(row) != _OF_IK_BONES:
            wrong = "an IK bone has only a parent, and follows, a bone's name"
        axes = None
    else:
        axes = _axes(row.get("axes"), where) or axes
        numbers = offset if isinstance(offset, list) else []
        valid = [type(n) in (int, float) and abs(n) < 100.0 for n in numbers]
        if offset is not None and valid != [True] * 3:
            wrong = f"offset is {shown(offset)}, expected three shares of stature"
    if wrong:
        raise InputError(f"{where}: {wrong}")
    if offset is not None:
        x, y, z = map(float, offset)
        offset = (x, y, z)
    at = float(at or 0.0)
    return Bone(name, parent, part, offset, axes, twist_of, at, follows)


def _check(bones: tuple[Bone, ...], source: str) -> None:
    part_of = dict[str | None, str | None]()
    for bone in bones:
        limb, wrong = part_of.get(bone.parent) or "", ""
        known = (limb, NEXT[limb]) if limb in NEXT else ()
        if bone.parent is not None and bone.parent not in part_of:
            wrong = f"its parent {shown(bone.parent)} is not listed before it; list "
            wrong += "every parent before its children"
        elif bone.follows is not None and bone.follows not in part_of:
            wrong = f"follows {shown(bone.follows)}, which is not listed before it; "
            wrong += "list bones before those that follow"
        elif bone.twist_of is not None and bone.twist_of not in known:
            wrong = f"twist_of is {shown(bone.twist_of)}, expected the part that turns "
            wrong += f"its parent, one of {', '.join(NEXT)}, or the next one"
        if wrong:
            raise InputError(f"{source}: bone {shown(bone.name)}: {wrong}")
        part_of[bone.name] = bone.part
    for part in PARTS:
        count = sum(bone.part == part for bone in bones)
        if count == 0 and part not in OPTIONAL:
            raise InputError(f"{source}: no bone is turned_by {part!r}; add one")
        if count > 1 and part not in _SEVERAL:
            raise InputError(f"{source}: {count} bones are turned_by {part!r}, not one")


def listed(names: Sequence[str]) -> str:
    """Return the first twelve names, for messages."""
    first = ", ".join(name[:30] for name in names[:12])
    return first + (", ..." if len(names) > 12 else "")


@dataclass(frozen=True)
class SourceJoint:
    """Place of a Kinect joint on another skeleton, with the fields of the file."""

    at: tuple[str, ...]
    others: tuple[tuple[str, ...], ...] = ()  # the field ``or``
    optional: bool = False


@dataclass(frozen=True)
class SourceRig:
    """A skeleton from which motion is read, by Kinect joint."""

    name: str
    title: str  # what the names are, for messages
    joints: dict[str, SourceJoint]

    @property
    def needed(self) -> set[str]:
        """Names of the joints that must be there, or alternatives to them."""
        joints = [joint for joint in self.joints.values() if not joint.optional]
        return {name for joint in joints for name in joint.at}

    def among(self, names: Set[str]) -> tuple[SourceRig, set[str]]:
        """Return the rig with those of its joints that exist, and the missing names."""
        present, missing = dict[str, SourceJoint](), set[str]()
        for joint, row in self.joints.items():
            matches = [at for at in (row.at, *row.others) if names >= set(at)]
            if matches:
                present[joint] = SourceJoint(matches[0])
            elif not row.optional:
                missing |= set(row.at) - names
        return replace(self, joints=present), missing


@cache
def load_source_rig(name: str, skeleton: Skeleton) -> SourceRig:
    """Return the rig in a file of ``source_rigs`` for the joints of a Kinect."""
    tables, joints = _embedded("source_rigs", name), {}
    for joint, row in tables["limbs"].items():
        joints[f"{joint}Left"] = _source_joint(row)
        joints[f"{joint}Right"] = _source_joint(row, right=True)
    for joint, row in tables["trunk"].items():
        known = joint if joint in skeleton.joints else _KINECT_V1.get(joint)
        if known:
            joints[known] = _source_joint(row)
    return SourceRig(name, tables["title"], joints)


def _source_joint(row: dict[str, Any], *, right: bool = False) -> SourceJoint:
    def named(name: str) -> str:
        swap = {"Left": "Right", "L": "R", "l": "r"}
        return re.sub("^(Left|L|l)", lambda m: swap[m[0]], name) if right else name

    at, *others = (tuple(map(named, n)) for n in (row["at"], *row.get("or", ())))
    return SourceJoint(at, tuple(others), row.get("optional", False))


def matching_source_rig(
    names: Collection[str], skeleton: Skeleton, known: Sequence[str]
) -> tuple[SourceRig, list[str]]:
    """Return the rig to which joints belong, and which of its joints are missing.

    This is the first rig without missing joints or, if there is none, the one with the
    smallest share of them. ``known`` are files of ``source_rigs``, most specific first.
    """
    fine = ("HandTip", "Thumb")
    own = [joint for joint in skeleton.joints if not joint.startswith(fine)]
    title = f"the joint names of {skeleton.name}"
    kinect = SourceRig(skeleton.name, title, {j: SourceJoint((j,)) for j in own})
    rigs = [kinect, *(load_source_rig(name, skeleton) for name in known)]
    found = [rig.among(set(names)) for rig in rigs]
    shares = [len(f[1]) / len(rig.needed) for f, rig in zip(found, rigs, strict=True)]
    best = int(np.argmin(shares))
    present, missing = found[best]
    return (rigs[best] if missing else present), sorted(missing)
