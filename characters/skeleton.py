"""Skeletons of the sensors: joint names, hierarchy and mirror pairs."""

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Array, Flags, Indices, check_choice, shown
from .errors import InputError

SIDES = ("Left", "Right")
"""Suffixes of paired joints; arrays with a row per side have this order."""
LIMB_PARTS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
"""Joints of arms and legs that every tracker and mocap have, without their side."""


@dataclass(frozen=True)
class Skeleton:
    """A tree of named joints.

    A segment is named after the joint at which it ends, so arrays over segments are as
    long as arrays over joints; the root's row has no bone.
    """

    name: str  # short name used in files, such as ``kinect_v1``
    joints: tuple[str, ...]  # joint names in the sensor's own order
    parents: tuple[int, ...]  # index of each joint's parent, -1 for the root

    def __post_init__(self) -> None:
        joints, parents = self.joints, self.parents
        for given, kind in ((joints, str), (parents, int)):
            if not isinstance(given, tuple) or {type(one) for one in given} != {kind}:
                raise InputError(
                    f"a skeleton needs a tuple of {kind.__name__}, got {shown(given)}"
                )
        tree = len(set(joints)) == len(parents) == len(joints) and -1 in parents
        if not tree or min(parents) < -1 or len(self.order) != len(joints):
            raise InputError(
                f"the joints of skeleton {shown(self.name)} are not a tree: give each "
                "a unique name and the index of its parent, -1 for the root"
            )

    def __len__(self) -> int:
        return len(self.joints)

    def index(self, joint: str) -> int:
        """Return the index of ``joint``; raises InputError if it does not exist."""
        if not isinstance(joint, str) or joint not in self.joints:
            raise InputError(
                f"skeleton {self.name} has no joint {shown(joint)}; it has "
                + ", ".join(self.joints)
            )
        return self.joints.index(joint)

    @cached_property
    def root(self) -> int:
        """Index of the root joint."""
        return self.parents.index(-1)

    def sides(self, part: str) -> list[int]:
        """Return the indices of the left and right joint of a part such as Knee."""
        return [self.index(part + side) for side in SIDES]

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Name of each joint without its side."""
        return tuple(re.sub("(Left|Right)$", "", joint) for joint in self.joints)

    @cached_property
    def hips(self) -> Indices:
        """Indices of the left and the right hip."""
        return np.array(self.sides("Hip"))

    @cached_property
    def across(self) -> Indices:
        """Indices of the left joints, then the right ones, of hips and shoulders."""
        return np.transpose([self.sides("Hip"), self.sides("Shoulder")])

    @cached_property
    def girdle(self) -> int:
        """Index of the spine's joint from which the shoulders branch off."""
        return self.parents[self.index("ShoulderLeft")]

    @cached_property
    def hands(self) -> Flags:
        """Flags of the joints beyond the wrists, shape (J,)."""
        return np.array([j.startswith(("Hand", "Thumb")) for j in self.joints])

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Joint indices sorted so that every parent precedes its children."""
        return (self.root, *self.descendants(self.root))

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Indices of each joint's children."""
        pairs = list(enumerate(self.parents))
        return tuple(tuple(c for c, p in pairs if p == j) for j in range(len(self)))

    @cached_property
    def legs(self) -> Indices:
        """Indices of the joints below the left hip, then of those below the right."""
        return np.array([j for hip in self.sides("Hip") for j in self.descendants(hip)])

    def ancestors(self, joint: int) -> list[int]:
        """Return the indices of a joint and its ancestors, without the root."""
        parent = self.parents[joint]
        return [] if parent < 0 else [joint, *self.ancestors(parent)]

    def descendants(self, joint: int) -> list[int]:
        """Return the indices of a joint's descendants, nearest first."""
        joints = list(self.children[joint])
        for descendant in joints:
            joints.extend(self.children[descendant])
        return joints

    @cached_property
    def segments(self) -> Indices:
        """Indices of the joints that end a segment: all but the root, in ``order``."""
        return np.array(self.order[1:])

    @cached_property
    def segment_parents(self) -> Indices:
        """Index of the joint at which each of ``segments`` starts."""
        return np.array([self.parents[j] for j in self.segments])

    def bones(self, positions: Array) -> Array:
        """Return the vector from start to end of each of ``segments``, (..., S, 3)."""
        # Twice as fast as indices in brackets.
        ends, starts = self.segments, self.segment_parents
        return np.asarray(positions.take(ends, -2) - positions.take(starts, -2))

    @cached_property
    def mirror(self) -> Indices:
        """Permutation that swaps the left and right joint of every pair."""
        swap = {"Left": "Right", "Right": "Left"}
        names = [re.sub("(Left|Right)$", lambda s: swap[s[0]], j) for j in self.joints]
        return np.array([self.index(name) for name in names])


def _skeleton(name: str, *hierarchy: str) -> Skeleton:
    """Return a skeleton from ``joint:parent`` words in the sensor's order."""
    pairs = [word.partition(":")[::2] for word in " ".join(hierarchy).split()]
    joints = tuple(joint for joint, _ in pairs)
    return Skeleton(name, joints, tuple(joints.index(p) if p else -1 for _, p in pairs))


_LIMBS = """
ShoulderLeft:{0} ElbowLeft:ShoulderLeft WristLeft:ElbowLeft HandLeft:WristLeft
ShoulderRight:{0} ElbowRight:ShoulderRight WristRight:ElbowRight HandRight:WristRight
HipLeft:{1} KneeLeft:HipLeft AnkleLeft:KneeLeft FootLeft:AnkleLeft
HipRight:{1} KneeRight:HipRight AnkleRight:KneeRight FootRight:AnkleRight
"""
KINECT_V1 = _skeleton(
    "kinect_v1",
    "HipCenter Spine:HipCenter ShoulderCenter:Spine Head:ShoulderCenter",
    _LIMBS.format("ShoulderCenter", "HipCenter"),
)
"""Kinect for Windows SDK 1.x: 20 joints, 19 segments, in the SDK's order."""

KINECT_V2 = _skeleton(
    "kinect_v2",
    "SpineBase SpineMid:SpineBase Neck:SpineShoulder Head:Neck",
    _LIMBS.format("SpineShoulder", "SpineBase"),
    "SpineShoulder:SpineMid HandTipLeft:HandLeft ThumbLeft:WristLeft",
    "HandTipRight:HandRight ThumbRight:WristRight",
)
"""Kinect for Windows SDK 2.0: 25 joints, 24 segments, in the SDK's order."""

SKELETONS = {skeleton.name: skeleton for skeleton in (KINECT_V1, KINECT_V2)}
"""All supported skeletons, by name."""


def skeleton_named(name: str) -> Skeleton:
    """Return the skeleton with a name; raises InputError if it is unknown."""
    check_choice(name, SKELETONS, "skeleton")
    return SKELETONS[name]


def check_skeleton(skeleton: object, what: str) -> None:
    """Raise an InputError if a value is not one of SKELETONS."""
    if not isinstance(skeleton, Skeleton) or skeleton not in SKELETONS.values():
        raise InputError(
            f"{what}: its skeleton is {shown(skeleton)}; give KINECT_V1 or KINECT_V2 "
            "from kinefilter.characters"
        )
