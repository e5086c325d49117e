"""Skeletons as animation formats need them, with constant bone lengths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from kinefilter.characters import SKELETONS, Body, Clip, Motion, Skeleton, standard_body
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotate
from kinefilter.retarget.retargeting import Retargeted, rig_frame, segment_of
from kinefilter.retarget.standardize import measured_body
from kinefilter.retarget.target_rig import RestPose, TargetRig

RootMotion = Literal["travel", "in-place", "none"]
"""Root motion that is kept: all of it, only the turns, or none."""


@dataclass(frozen=True, eq=False)
class Rig(RestPose):
    """A skeleton at rest as files have it: nodes that rotate everything below them.

    In a clip every segment has its own rotation. So where a joint branches, each child
    gets a helper node ``<Child>Pivot`` at the same place, which rotates with the
    child's segment. A joint with one child rotates with that child's segment, and a
    leaf with its own. On other rigs every node has its own segment.
    """

    segments: Indices = field(kw_only=True)
    """Index of the segment that each node rotates with, shape (N,)."""

    @cached_property
    def segment_nodes(self) -> Indices:
        """Index of the node at the start of each segment, which rotates it, (J,)."""
        return np.unique(self.segments, return_index=True)[1]

    def local_rotation(self, rotations: Array, node: int) -> Array:
        """Return one node's rotation relative to its parent, wxyz, shape (..., 4).

        ``rotations`` are the world rotations of a clip's segments, (..., J, 4).
        """

        def world(node: int) -> Array:
            turn = rotations[..., self.segments[node], :]
            return turn if self.axes is None else multiply(turn, self.axes[node])

        parent = self.parents[node]
        local = world(node)
        return local if parent < 0 else multiply(inverse(world(parent)), local)

    def local_rotations(self, rotations: Array) -> Array:
        """Return the ``local_rotation`` of every node, shape (..., N, 4)."""
        nodes = [self.local_rotation(rotations, n) for n in range(len(self))]
        return np.stack(nodes, axis=-2)

    def world_rotations(self, local: Array) -> Array:
        """Return the world rotations of nodes from the local ones, wxyz, (T, N, 4)."""
        world = local.copy()
        for n, parent in enumerate(self.parents[1:], start=1):
            world[:, n] = multiply(world[:, parent], local[:, n])
        return world

    @cached_property
    def at_rest(self) -> tuple[Array, Array]:
        """Local position [m] (N, 3) and rotation (N, 4) of each node at rest."""
        still = np.tile(IDENTITY, (int(self.segments.max()) + 1, 1))
        places, above = self.positions.copy(), list(self.parents[1:])
        places[1:] -= self.positions[above]
        if self.axes is not None:
            places[1:] = rotate(inverse(self.axes[above]), places[1:])
        return places, self.local_rotations(still)


def rig_of(body: Body) -> Rig:
    """Return the rig for a body on kinefilter's own skeleton."""
    skeleton = body.skeleton
    nodes: list[tuple[str, int, int, int]] = []  # name, parent, joint, segment

    def add_joint(joint: int, parent: int) -> None:
        children, name = skeleton.children[joint], skeleton.joints[joint]
        branches = len(children) > 1 or joint == skeleton.root
        segment = joint if branches or not children else children[0]
        node = len(nodes)
        nodes.append((name, parent, joint, segment))
        for child in children:
            if branches:
                nodes.append((f"{skeleton.joints[child]}Pivot", node, joint, child))
            add_joint(child, len(nodes) - 1 if branches else node)

    add_joint(skeleton.root, -1)
    names, parents, joints, segments = zip(*nodes, strict=True)
    places = body.rest_positions[list(joints)]
    return Rig(names, parents, places, segments=np.array(segments))


def own_skeleton(names: Sequence[str]) -> Skeleton | None:
    """Return the skeleton whose rig has nodes with these names, or None."""
    skeletons = {rig_of(standard_body(s)).names: s for s in SKELETONS.values()}
    return skeletons.get(tuple(names))


def motion_of_rig(
    skeleton: Skeleton,
    offsets: Array,
    rotations: Array,
    root: Array,
    time: Array,
    source: str,
) -> Motion:
    """Convert the motion of a skeleton's own rig to a Motion.

    Rest offsets from each node's parent [m] have shape (N, 3), world rotations of the
    nodes (T, N, 4), positions of the root [m] (T, 3), time stamps [s] (T,). Raises
    InputError if no person has such segments.
    """
    rig = rig_of(standard_body(skeleton))
    bones = offsets[[rig.names.index(joint) for joint in skeleton.joints]]
    bones[skeleton.root] = 0.0
    lengths = np.linalg.norm(bones, axis=1)
    directions = bones / np.maximum(lengths, 1e-12)[:, None]
    person = measured_body(skeleton, lengths, directions, source=source)
    body = replace(person, lengths=lengths, directions=directions)
    turns = rotations[:, rig.segment_nodes]
    return Motion(time=time, body=body, root=root, rotations=turns, source=source)


@dataclass(frozen=True, eq=False)
class RigMotion:
    """The motion of a rig."""

    rig: Rig
    rotations: Array  # world rotations of the segments from rest, wxyz, (T, S, 4)
    places: Mapping[int, Array]
    """Local positions [m] (T, 3) of the nodes that move in their parent, by index: the
    root, the pelvis, and IK bones."""
    positions: Array  # world positions [m] of all distinct joints, shape (T, J, 3)
    turned_by: Mapping[str, int]
    """Index of the sensor's joint at the end of the segment that rotates a node, by the
    node's name. Nodes that no segment rotates are left out."""


def own_motion(clip: Clip) -> RigMotion:
    """Return a clip's motion on the rig of its body."""
    rig, places = rig_of(clip.body), {0: clip.positions[:, clip.skeleton.root]}
    turned_by = dict(zip(rig.names, rig.segments.tolist(), strict=True))
    return RigMotion(rig, clip.rotations, places, clip.positions, turned_by)


def retargeted_motion(
    target: TargetRig, motion: Retargeted, skeleton: Skeleton, travel: RootMotion
) -> RigMotion:
    """Return a motion of the sensor's skeleton on a target, with the root motion."""
    rest = target.rest
    rig = Rig(**vars(rest), segments=np.arange(len(rest)))
    rotations, positions = motion.rotations, motion.positions
    if travel != "travel":
        frame = rig_frame(target, motion)
        frame = frame if travel == "none" else frame.unturned
        rotations = frame.remove_rotations(rotations)
        positions = frame.remove(positions)
    places = {0: positions[:, 0]}
    for node in {target.joint("pelvis"), *target.followed} - {0}:
        above = rig.parents[node]
        path = positions[:, node] - positions[:, above]
        path = rotate(inverse(rotations[:, above]), path)
        if rig.axes is not None:
            path = rotate(inverse(rig.axes[above]), path)
        places[node] = path
    turned_by = {
        rest.names[node]: segment_of(skeleton, part)
        for part, nodes in target.parts.items()
        for node in nodes
    }
    return RigMotion(rig, rotations, places, positions, turned_by)
