"""The skeleton that animation formats get: every bone length constant, no bend lost.

It is our own, or that of somebody else's rig.
"""

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

Travel = Literal["travel", "in-place", "none"]
"""What is left of a motion's way over the floor: all, the turns, or nothing."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A tree of nodes, each of which turns all its children together.

    In a clip every segment has a rotation of its own, so the segments that leave one
    joint turn apart. Animation formats let a node turn all that hangs on it. So where
    a joint branches, a node ``<Child>Pivot`` sits in the same place for each child and
    turns with the child's segment; a joint with one child turns with that child's
    segment, a leaf with its own. On somebody else's rig each node turns for itself.
    """

    names: tuple[str, ...]  # the sensor's for a joint, ``<Child>Pivot`` for a helper
    parents: tuple[int, ...]  # index of each node's parent, -1 for the root
    offsets: Array  # vector [m] from the parent in the T-pose, shape (N, 3), root 0
    segments: Indices  # the skeleton's that each node turns with, shape (N,)
    root: Array  # position of the root in the T-pose [m], shape (3,)
    axes: Array | None = None
    """World rotation of each node's own axes in the rest pose, wxyz, shape (N, 4);
    None: those of the world."""
    mover: int = 0
    """Index of the node that changes place in its parent: the root, or the pelvis of a
    rig whose root stays on the floor."""
    axes_in_bvh: bool = False
    """Whether BVH has the axes too, and so no rest pose."""

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
    def depth_first(self) -> tuple[int, ...]:
        """Indices of the nodes, each before all that hangs on it, branch by branch."""
        order, waiting = [], [0]
        while waiting:
            node = waiting.pop()
            order.append(node)
            children = [n for n, parent in enumerate(self.parents) if parent == node]
            waiting.extend(reversed(children))
        return tuple(order)

    @cached_property
    def starts(self) -> Indices:
        """Index of the node at each segment's start, which turns it, shape (J,)."""
        segments = self.segments.tolist()
        return np.array([segments.index(j) for j in range(max(segments) + 1)])

    def local_rotation(self, rotations: Array, node: int) -> Array:
        """Return one node's rotation relative to its parent's, wxyz, shape (..., 4).

        Rotations are those of a clip's segments in the world, (..., J, 4).
        """

        def world(node: int) -> Array:
            turn = rotations[..., self.segments[node], :]
            return turn if self.axes is None else multiply(turn, self.axes[node])

        parent = self.parents[node]
        if parent < 0:
            return world(node)
        return multiply(inverse(world(parent)), world(node))

    @cached_property
    def at_rest(self) -> tuple[Array, Array]:
        """Each node's place [m] (N, 3) and rotation (N, 4) in its parent (or world)."""
        still = np.tile(IDENTITY, (int(self.segments.max()) + 1, 1))
        places = self.offsets.copy()
        places[0] = self.root
        if self.axes is not None:
            above = self.axes[list(self.parents[1:])]
            places[1:] = rotate(inverse(above), places[1:])
        return places, self.local_rotations(still)

    def world_rotations(self, local: Array) -> Array:
        """Return world rotations (T, N, 4) of nodes turned in their parents, wxyz."""
        world = local.copy()
        for n, parent in enumerate(self.parents[1:], start=1):
            world[:, n] = multiply(world[:, parent], local[:, n])
        return world

    def local_rotations(self, rotations: Array) -> Array:
        """Return every node's rotation as ``local_rotation`` does, (..., N, 4)."""
        nodes = [self.local_rotation(rotations, n) for n in range(len(self))]
        return np.stack(nodes, axis=-2)


def rig_of(body: Body) -> Rig:
    """Return the rig of a body."""
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
    """Return the skeleton whose rig has nodes of these names, None if none has."""
    for skeleton in SKELETONS.values():
        if tuple(names) == rig_of(standard_body(skeleton)).names:
            return skeleton
    return None


def motion_of_rig(
    skeleton: Skeleton,
    offsets: Array,
    rotations: Array,
    root: Array,
    time: Array,
    source: str,
) -> Motion:
    """Return what a skeleton's own rig does as a motion.

    Offsets from each node's parent in the rest pose [m] are (N, 3), world rotations of
    the nodes (T, N, 4), positions of the root [m] (T, 3), time stamps [s] (T,). Raises
    InputError if no person has such segments.
    """
    rig = rig_of(standard_body(skeleton))
    bones = offsets[[rig.names.index(joint) for joint in skeleton.joints]].copy()
    bones[skeleton.root] = 0.0
    lengths = np.linalg.norm(bones, axis=1)
    directions = bones / np.maximum(lengths, 1e-12)[:, None]
    person = measured_body(skeleton, lengths, directions, source=source)
    body = replace(person, lengths=lengths, directions=directions)
    turns = rotations[:, rig.starts]
    return Motion(time=time, body=body, root=root, rotations=turns, source=source)


@dataclass(frozen=True, eq=False)
class RigMotion:
    """What a rig does."""

    rig: Rig
    rotations: Array  # of its segments since the rest pose, world, wxyz, (T, S, 4)
    places: Mapping[int, Array]
    """Where nodes are in their parents [m], (T, 3), by index: ``rig.mover``, and a root
    below it that moves over the floor."""
    positions: Array  # world positions of joints, all that differ [m], shape (T, J, 3)
    turned_by: Mapping[str, int]
    """Index of the sensor's joint at the end of the segment that turns a node, by the
    node's name; without nodes that no segment turns."""


def own_motion(clip: Clip) -> RigMotion:
    """Return a clip's motion on the rig of its body."""
    rig, places = rig_of(clip.body), {0: clip.positions[:, clip.skeleton.root]}
    turned_by = dict(zip(rig.names, rig.segments.tolist(), strict=True))
    return RigMotion(rig, clip.rotations, places, clip.positions, turned_by)


def retargeted_motion(
    target: TargetRig,
    motion: Retargeted,
    skeleton: Skeleton,
    travel: Travel = "travel",
) -> RigMotion:
    """Return a sensor's motion on another skeleton, whose nodes turn each for itself.

    ``travel`` says what is left of its way over the floor.
    """
    rest, mover = target.rest, target.joint("pelvis")
    offsets = rest.positions - rest.positions[np.array(rest.parents)]
    offsets[0] = 0.0
    segments, root = np.arange(len(rest)), rest.positions[0]
    known = (rest.names, rest.parents, offsets, segments, root, rest.axes, mover)
    rig = Rig(*known, rest.axes_in_bvh)
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
