"""Skeletons that motion comes on, and where the Kinect's joints lie on them."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

from kinefilter.characters import Skeleton


@dataclass(frozen=True)
class SourceJoint:
    """Where a Kinect joint lies on another skeleton."""

    at: tuple[str, ...]
    """At the mean of these joints."""
    turned_by: str | None
    """The joint that turns the segment which ends there; None: no one knows."""


@dataclass(frozen=True)
class SourceRig:
    """A skeleton that motion comes on."""

    name: str
    """Name of its file in ``source_rigs``, or of the Kinect whose joints it has."""
    joints: dict[str, SourceJoint]
    """By the Kinect joint; those that it has not are left out."""

    @property
    def needed(self) -> set[str]:
        """Names of the joints that must be there."""
        names = {name for joint in self.joints.values() for name in joint.at}
        return names | {j.turned_by for j in self.joints.values() if j.turned_by}


@cache
def load_source_rig(name: str, skeleton: Skeleton) -> SourceRig:
    """Return a rig for a Kinect's joints from its data file in ``source_rigs``."""
    text = (
        resources.files("kinefilter.retarget")
        .joinpath("source_rigs", f"{name}.toml")
        .read_text(encoding="utf-8")
    )
    tables = tomllib.loads(text)
    rows = {**tables["limbs"], **tables[skeleton.name]}
    return SourceRig(
        name,
        {
            joint: SourceJoint(tuple(row["at"]), row.get("turned_by"))
            for joint, row in rows.items()
        },
    )


@cache
def _own(skeleton: Skeleton) -> SourceRig:
    """Return the rig whose joints are the Kinect's own, fingers left out."""
    fine = ("HandTip", "Thumb")
    names = [joint for joint in skeleton.joints if not joint.startswith(fine)]
    return SourceRig(
        skeleton.name, {name: SourceJoint((name,), None) for name in names}
    )


def matching_source_rig(
    names: Collection[str], skeleton: Skeleton, known: Sequence[str]
) -> tuple[SourceRig, list[str]]:
    """Return the rig that joints are of, and which of its joints are missing.

    The first whose joints are all there; if there is none, the one that lacks the
    smallest share of its own.

    Args:
        names: Names of the joints that there are.
        skeleton: The Kinect's joints that are wanted.
        known: Names of the data files to try, the most particular first.
    """
    rigs = [_own(skeleton), *(load_source_rig(name, skeleton) for name in known)]
    lacks = [sorted(rig.needed - set(names)) for rig in rigs]
    best = min(range(len(rigs)), key=lambda k: len(lacks[k]) / len(rigs[k].needed))
    return rigs[best], lacks[best]
