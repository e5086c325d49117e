"""Maps between our joints and other skeletons, in TOML files.

Those in ``rigs``, or the user's, say which part of the body turns which bones of a
skeleton. Those in ``source_rigs`` go the other way: they say where a Kinect's joints
lie on a skeleton that motion comes on, and know neither parents nor a rest pose.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Sequence, Set
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import shown

_HERE = Path(__file__).parent
RIGS = tuple(sorted(path.stem for path in (_HERE / "rigs").glob("*.toml")))
"""Names of the maps that kinefilter has."""

SIDES = ("left", "right")
_LIMBS = {  # part: the part it hangs on
    "clavicle": None,
    "upper arm": None,
    "lower arm": "upper arm",
    "hand": "lower arm",
    "thigh": None,
    "shin": "thigh",
    "foot": "shin",
    "toes": "foot",
}
CHAINS = {
    f"{side} {part}": f"{side} {above}" if above else "pelvis"
    for side in SIDES
    for part, above in _LIMBS.items()
} | {"spine": "pelvis", "neck": "pelvis", "head": "pelvis"}
"""Part of the body, and the part on which it hangs."""
PARTS = ("pelvis", *CHAINS)
"""What turns bones."""
OPTIONAL = {"neck", *(f"{s} {part}" for s in SIDES for part in ("clavicle", "toes"))}
"""Parts that a skeleton may lack."""
_SEVERAL = ("spine", "neck")
_FIELDS = {"parent", "turned_by", "offset", "axes"}
WORDS = {
    "left": (1.0, 0.0, 0.0),
    "right": (-1.0, 0.0, 0.0),
    "up": (0.0, 1.0, 0.0),
    "down": (0.0, -1.0, 0.0),
    "ahead": (0.0, 0.0, 1.0),
    "back": (0.0, 0.0, -1.0),
}
"""Directions in which a bone's axes may point at rest, besides any three numbers (x to
the left, y up, z ahead) and ``on``, which is along the bone."""
_NUMBER = r"-?[01]?\.?\d{1,9}"
_ONE_AXIS = rf"(-?[xyz]) (on|{'|'.join(WORDS)}|{_NUMBER} {_NUMBER} {_NUMBER})"
_AXES = re.compile(f"{_ONE_AXIS}, {_ONE_AXIS}")
Axes = tuple[tuple[str, str], tuple[str, str]]
"""Two axes (``x``, ``-x``) and where they point, the second as nearly as it can."""


@dataclass(frozen=True)
class MapBone:
    """A bone of another skeleton, from the joint of its name on.

    The root has no parent, and what its parent alone turns has no part (PARTS). The
    offset from the parent in the rest pose is in shares of stature, x to the left, y
    up, z ahead; a bone without is looked for in a target, but not built. Without axes
    a bone has those of the world.
    """

    name: str
    parent: str | None
    part: str | None
    offset: tuple[float, float, float] | None
    axes: Axes | None = None


@dataclass(frozen=True)
class RigMap:
    """Names, hierarchy and rest pose of another skeleton, parents before children.

    Its files write the prefix before every name, or leave it out. BVH, which has no
    rest rotations, has the bones' axes in its motion if ``axes_in_bvh``.
    """

    name: str
    prefix: str
    bones: tuple[MapBone, ...]
    axes_in_bvh: bool = False

    def of(self, part: str) -> list[MapBone]:
        """Return the bones that a part turns, from the root on."""
        return [bone for bone in self.bones if bone.part == part]

    def plain(self, name: str) -> str:
        """Return a joint's name without namespace and prefix, in lower case."""
        bare = name.rpartition(":")[2].strip().casefold()
        stem = re.escape(self.prefix.rstrip(":_").casefold())
        return re.sub(rf"^{stem}\d*[:_]", "", bare) if stem else bare


@cache
def load_rig_map(rig: str) -> RigMap:
    """Return one of RIGS."""
    return rig_map_of(_embedded("rigs", rig), rig)


def _embedded(folder: str, name: str) -> dict[str, Any]:
    return tomllib.loads((_HERE / folder / f"{name}.toml").read_text(encoding="utf-8"))


def rig_map_of(table: dict[str, Any], source: str) -> RigMap:
    """Return the map in the table of a TOML file, or raise InputError."""
    rows, prefix = table.get("bones"), table.get("prefix", "")
    in_bvh = table.get("axes_in_bvh", False)
    if not isinstance(rows, dict) or not isinstance(prefix, str):
        raise InputError(
            f"{source}: expected a table [bones], a row for each joint, and at most a "
            "text 'prefix'"
        )
    known = ("prefix", "axes", "axes_in_bvh", "bones")
    if unknown := sorted(set(table) - set(known)):
        raise InputError(
            f"{source}: unknown {unknown[0]!r}; expected {', '.join(known)}"
        )
    if not isinstance(in_bvh, bool):
        raise InputError(f"{source}: axes_in_bvh is {shown(in_bvh)}, expected true")
    axes = _axes(table.get("axes"), source)
    bones = tuple(_bone(name, row, axes, source) for name, row in rows.items())
    _check(bones, source)
    return RigMap(source, prefix, bones, in_bvh)


def _axes(words: Any, where: str) -> Axes | None:
    """Return the axes in words such as ``y on, -z ahead``."""
    if words is None:
        return None
    found = _AXES.fullmatch(words) if isinstance(words, str) else None
    if found is None or found[1][-1] == found[3][-1]:
        raise InputError(
            f"{where}: axes are {shown(words)}, expected two such as 'y on, -z back'; "
            f"axes point on, {', '.join(WORDS)}, or to three numbers such as 0 -0.6 0.8"
        )
    return (found[1], found[2]), (found[3], found[4])


def _bone(name: str, row: Any, axes: Axes | None, source: str) -> MapBone:
    where = f"{source}: bone {shown(name)}"
    if not isinstance(row, dict) or not _FIELDS.issuperset(row):
        raise InputError(f"{where}: expected fields {', '.join(sorted(_FIELDS))}")
    part, parent, offset = (row.get(k) for k in ("turned_by", "parent", "offset"))
    if part is not None and part not in PARTS:
        raise InputError(
            f"{where}: unknown turned_by {shown(part)}; expected one of "
            f"{', '.join(PARTS)}"
        )
    if parent is not None and not isinstance(parent, str):
        raise InputError(f"{where}: parent is {shown(parent)}, expected a bone's name")
    axes = _axes(row.get("axes"), where) or axes
    if offset is None:
        return MapBone(name, parent, part, None, axes)
    numbers = offset if isinstance(offset, list) else []
    known = [n for n in numbers if type(n) in (int, float) and abs(n) < 100.0]
    if len(numbers) != 3 or len(known) != 3:
        raise InputError(f"{where}: offset is {shown(offset)}, expected three shares")
    x, y, z = (float(n) for n in known)
    return MapBone(name, parent, part, (x, y, z), axes)


def _check(bones: tuple[MapBone, ...], source: str) -> None:
    seen: set[str] = set()
    for bone in bones:
        if bone.parent is not None and bone.parent not in seen:
            raise InputError(
                f"{source}: bone {shown(bone.name)}: its parent {shown(bone.parent)} "
                "is not before it; list every parent before its children"
            )
        seen.add(bone.name)
    for part in PARTS:
        count = sum(bone.part == part for bone in bones)
        if count == 0 and part not in OPTIONAL:
            raise InputError(f"{source}: no bone is turned_by {part!r}; name the one")
        if count > 1 and part not in _SEVERAL:
            raise InputError(f"{source}: {count} bones are turned_by {part!r}, not one")


def listed(names: Sequence[str]) -> str:
    """Return the first twelve names, for messages."""
    some = ", ".join(name[:30] for name in names[:12])
    return some + (", ..." if len(names) > 12 else "")


# Where motion comes from


@dataclass(frozen=True)
class SourceJoint:
    """Where a Kinect joint lies on another skeleton: at the mean of these joints.

    ``turned_by`` is the joint that turns the segment which ends there, if it is known;
    ``others`` are where it lies if the skeleton lacks the first ones, the best first.
    """

    at: tuple[str, ...]
    turned_by: str | None = None
    others: tuple[tuple[str, ...], ...] = ()
    optional: bool = False


@dataclass(frozen=True)
class SourceRig:
    """A skeleton that motion comes on: a file in ``source_rigs``, or a Kinect's own.

    Its joints are by the Kinect joint; those that it has not are left out.
    """

    name: str
    joints: dict[str, SourceJoint]

    @property
    def needed(self) -> set[str]:
        """Names of the joints that must be there, or what stands for them."""
        joints = [joint for joint in self.joints.values() if not joint.optional]
        names = {name for joint in joints for name in joint.at}
        return names | {joint.turned_by for joint in joints if joint.turned_by}

    def among(self, names: Set[str]) -> tuple[SourceRig, set[str]]:
        """Return the rig with the joints that are there, and what it lacks."""
        there, lacks = dict[str, SourceJoint](), set[str]()
        for joint, row in self.joints.items():
            by = {row.turned_by} if row.turned_by else set[str]()
            found = [at for at in (row.at, *row.others) if by.union(at) <= names]
            if found:
                there[joint] = SourceJoint(found[0], row.turned_by)
            elif not row.optional:
                lacks |= by.union(row.at) - names
        return SourceRig(self.name, there), lacks


@cache
def load_source_rig(name: str, skeleton: Skeleton) -> SourceRig:
    """Return a rig for a Kinect's joints from its data file in ``source_rigs``."""
    tables = _embedded("source_rigs", name)
    rows = {**tables["limbs"], **tables[skeleton.name]}
    joints = {
        joint: SourceJoint(
            tuple(row["at"]),
            row.get("turned_by"),
            tuple(map(tuple, row.get("or", ()))),
            row.get("optional", False),
        )
        for joint, row in rows.items()
    }
    return SourceRig(name, joints)


def matching_source_rig(
    names: Collection[str], skeleton: Skeleton, known: Sequence[str]
) -> tuple[SourceRig, list[str]]:
    """Return the rig that joints are of, and which of its joints are missing.

    The first whose joints are all there; if there is none, the one that lacks the
    smallest share of its own. ``known`` are data files, the most particular first.
    """
    fine = ("HandTip", "Thumb")
    own = [joint for joint in skeleton.joints if not joint.startswith(fine)]
    kinect = SourceRig(skeleton.name, {j: SourceJoint((j,)) for j in own})
    rigs = [kinect, *(load_source_rig(name, skeleton) for name in known)]
    found = [rig.among(set(names)) for rig in rigs]
    shares = [len(f[1]) / len(rig.needed) for f, rig in zip(found, rigs, strict=True)]
    best = int(np.argmin(shares))
    there, lacks = found[best]
    return (rigs[best] if lacks else there), sorted(lacks)
