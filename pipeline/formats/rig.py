"""Skeletons as animation formats need them, with constant bone lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from kinefilter.characters import SKELETONS, Body, Clip, Motion, Skeleton, standard_body
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotate
from kinefilter.retarget.body_size import measured_body
from kinefilter.retarget.retargeting import Retargeted, rig_frame, segment_of
from kinefilter.retarget.target_rig import TargetRig

RootMotion = Literal["travel", "in-place", "none"]
"""Root motion that is kept: all of it, only the turns, or none."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A tree of nodes, each of which rotates everything below it.

    In a clip every segment has its own rotation. So where a joint branches, each child
    gets a helper node ``<Child>Pivot`` at the same place, which rotates with the
    child's segment. A joint with one child rotates with that child's segment, and a
    leaf with its own. On other rigs every node has its own segment.
    """

    names: tuple[str, ...]  # the sensor's for a joint, ``<Child>Pivot`` for a helper
    parents: tuple[int, ...]  # index of each node's parent, -1 for the root
    offsets: Array  # vector [m] from the parent in the T-pose, shape (N, 3), root 0
    segments: Indices  # index of the segment that each node rotates with, shape (N,)
    root: Array  # position of the root in the T-pose [m], shape (3,)
    axes: Array | None = None
    """World rotation of each node's axes in the rest pose, wxyz, shape (N, 4). None
    stands for the world's axes."""
    axes_in_bvh: bool = False  # BVH has the axes in its motion, and so no rest pose

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def rest_positions(self) -> Array:
        """T-pose position [m] of each node, soles on y = 0, shape (N, 3)."""
        positions = self.root + self.offsets
        for n, parent in enumerate(self.parents[1:], start=1):
            positions[n] = positions[parent] + self.offsets[n]
        return positions

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
        """Local position [m] (N, 3) and rotation (N, 4) of each node in the T-pose."""
        still = np.tile(IDENTITY, (int(self.segments.max()) + 1, 1))
        places = self.offsets.copy()
        places[0] = self.root
        if self.axes is not None:
            parent_axes = self.axes[list(self.parents[1:])]
            places[1:] = rotate(inverse(parent_axes), places[1:])
        return places, self.local_rotations(still)


def rig_of(body: Body) -> Rig:
    """Return the rig for a body on kinefilter's own skeleton."""
    skeleton = body.skeleton
    nodes: list[tuple[str, int, Array, int]] = []  # name, parent, offset, segment

    def add_joint(joint: int, parent: int) -> None:
        children, name = skeleton.children[joint], skeleton.joints[joint]
        branches = len(children) > 1 or joint == skeleton.root
        segment = joint if branches or not children else children[0]
        node = len(nodes)
        nodes.append((name, parent, body.rest_offsets[joint], segment))
        for child in children:
            if branches:
                pivot = f"{skeleton.joints[child]}Pivot"
                nodes.append((pivot, node, np.zeros(3), child))
            add_joint(child, len(nodes) - 1 if branches else node)

    add_joint(skeleton.root, -1)
    names, parents, offsets, segments = zip(*nodes, strict=True)
    root = body.rest_positions[skeleton.root]
    return Rig(names, parents, np.array(offsets), np.array(segments), root)


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
    root, and the pelvis."""
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
    target: TargetRig,
    motion: Retargeted,
    skeleton: Skeleton,
    travel: RootMotion = "travel",
) -> RigMotion:
    """Return a motion of the sensor's skeleton on a target, with the root motion."""
    rest, mover = target.rest, target.joint("pelvis")
    offsets = rest.positions - rest.positions[np.array(rest.parents)]
    offsets[0] = 0.0
    tree = (rest.names, rest.parents, offsets, np.arange(len(rest)), rest.positions[0])
    rig = Rig(*tree, rest.axes, rest.axes_in_bvh)
    rotations, positions = motion.rotations, motion.positions
    if travel != "travel":
        frame = rig_frame(target, motion)
        frame = frame if travel == "none" else frame.unturned
        rotations = frame.remove_rotations(rotations)
        positions = frame.remove(positions)
    places, above = {mover: positions[:, mover]}, rig.parents[mover]
    if above >= 0:
        path = positions[:, mover] - positions[:, above]
        path = rotate(inverse(rotations[:, above]), path)
        if rig.axes is not None:
            path = rotate(inverse(rig.axes[above]), path)
        places = {0: positions[:, 0], mover: path}
    turned_by = {
        rest.names[node]: segment_of(skeleton, part)
        for part, nodes in target.parts.items()
        for node in nodes
    }
    return RigMotion(rig, rotations, places, positions, turned_by)
