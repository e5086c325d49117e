"""The skeleton that animation formats get: every bone length constant, no bend lost.

It is our own, or that of somebody else's rig.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    SKELETONS,
    Body,
    Clip,
    Motion,
    Skeleton,
    standard_body,
)
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotate
from kinefilter.retarget.body_size import measured_body
from kinefilter.retarget.retargeting import Retargeted
from kinefilter.retarget.target_rig import RestPose, TargetRig


@dataclass(frozen=True, eq=False)
class Rig:
    """A tree of nodes, each of which turns all its children together.

    In a clip every segment has a rotation of its own, so the segments that leave one
    joint turn apart. Animation formats let a node turn all that hangs on it. So where
    a joint branches, a node ``<Child>Pivot`` sits in the same place for each child and
    turns with the child's segment; a joint with one child turns with that child's
    segment, a leaf with its own. On somebody else's rig each node turns for itself.
    """

    names: tuple[str, ...]
    """Name of each node: the sensor's for a joint, ``<Child>Pivot`` for a helper."""
    parents: tuple[int, ...]
    """Index of each node's parent, -1 for the root."""
    offsets: NDArray[np.float64]
    """Vector [m] from the parent in the T-pose, shape (N, 3), root 0."""
    segments: NDArray[np.intp]
    """Index of the skeleton's segment that each node turns with, shape (N,)."""
    leaves: tuple[int, ...]
    """Indices of the nodes without children."""
    root: NDArray[np.float64]
    """Position of the root in the T-pose [m], shape (3,)."""
    axes: NDArray[np.float64] | None = None
    """World rotation of each node's own axes in the rest pose, wxyz, shape (N, 4);
    None: those of the world."""
    mover: int = 0
    """Index of the node that changes place in its parent: the root, or the pelvis of a
    rig whose root stays on the floor."""

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def rest_positions(self) -> NDArray[np.float64]:
        """T-pose position [m] of each node, soles on y = 0, shape (N, 3)."""
        positions = np.empty((len(self), 3))
        for n, parent in enumerate(self.parents):
            start = self.root if parent < 0 else positions[parent]
            positions[n] = start + self.offsets[n]
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
    def starts(self) -> NDArray[np.intp]:
        """Index of the node at each segment's start, which turns it, shape (J,)."""
        segments = self.segments.tolist()
        return np.array([segments.index(j) for j in range(max(segments) + 1)])

    def local_rotation(
        self, rotations: NDArray[np.float64], node: int
    ) -> NDArray[np.float64]:
        """Return one node's rotation relative to its parent's.

        Args:
            rotations: World rotations of a clip's segments, wxyz, shape (..., J, 4).
            node: Index of the node.

        Returns:
            Unit quaternions wxyz, shape (..., 4); the root's are world rotations.
        """
        world = self._world(rotations, node)
        parent = self.parents[node]
        if parent < 0:
            return world
        return multiply(inverse(self._world(rotations, parent)), world)

    def _world(self, rotations: NDArray[np.float64], node: int) -> NDArray[np.float64]:
        world = rotations[..., self.segments[node], :]
        return world if self.axes is None else multiply(world, self.axes[node])

    @cached_property
    def at_rest(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Each node's place [m] and rotation in its parent, shapes (N, 3) and (N, 4).

        The root's are those in the world.
        """
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

    def without_axes(self) -> Rig:
        """Return the rig for formats whose rest pose has no rotations."""
        return replace(self, axes=None)

    def local_rotations(self, rotations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return every node's rotation relative to its parent's.

        Args:
            rotations: World rotations of a clip's segments, wxyz, shape (..., J, 4).

        Returns:
            Unit quaternions wxyz, shape (..., N, 4); the root's are world rotations.
        """
        nodes = [self.local_rotation(rotations, n) for n in range(len(self))]
        return np.stack(nodes, axis=-2)


def rig_of(body: Body) -> Rig:
    """Return the rig of a body."""
    nodes = list(_nodes(body.skeleton, body.skeleton.root, -1, 0))
    parents = tuple(node.parent for node in nodes)
    zero = np.zeros(3)
    return Rig(
        names=tuple(node.name for node in nodes),
        parents=parents,
        offsets=np.array(
            [zero if n.joint is None else body.rest_offsets[n.joint] for n in nodes]
        ),
        segments=np.array([node.segment for node in nodes]),
        leaves=tuple(n for n in range(len(nodes)) if n not in parents),
        root=body.rest_positions[body.skeleton.root],
    )


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

    Args:
        skeleton: The joints.
        offsets: Vector [m] from each node's parent in the rest pose, shape (N, 3).
        rotations: World rotation of each node, wxyz, shape (T, N, 4).
        root: Position of the root [m], shape (T, 3).
        time: Time stamps [s], shape (T,).
        source: Where it came from, for messages.

    Raises:
        InputError: No person has such segments.
    """
    rig = rig_of(standard_body(skeleton))
    bones = offsets[[rig.names.index(joint) for joint in skeleton.joints]].copy()
    bones[skeleton.root] = 0.0
    lengths = np.linalg.norm(bones, axis=1)
    directions = bones / np.maximum(lengths, 1e-12)[:, None]
    person = measured_body(skeleton, lengths, directions, source=source)
    return Motion(
        time=time,
        body=replace(person, lengths=lengths, directions=directions),
        root=root,
        rotations=rotations[:, rig.starts],
        source=source,
    )


@dataclass(frozen=True, eq=False)
class RigMotion:
    """What a rig does."""

    rig: Rig
    """The rig."""
    rotations: NDArray[np.float64]
    """World rotations of its segments since the rest pose, wxyz, shape (T, S, 4)."""
    path: NDArray[np.float64]
    """Place of the node ``rig.mover`` in its parent [m], shape (T, 3)."""
    positions: NDArray[np.float64]
    """World positions of joints, all that differ [m], shape (T, J, 3)."""


def motion_of(clip: Clip) -> RigMotion:
    """Return a clip's motion on its own rig."""
    path = clip.positions[:, clip.skeleton.root]
    return RigMotion(rig_of(clip.body), clip.rotations, path, clip.positions)


def retargeted_motion(target: TargetRig, motion: Retargeted) -> RigMotion:
    """Return a motion on another skeleton, whose nodes turn each for itself."""
    mover = target.joint("pelvis")
    rig = _rig_of_rest(target.rest, mover)
    above = rig.parents[mover]
    path = motion.positions[:, mover]
    if above >= 0:
        # All above the pelvis stays as it is at rest.
        path = path - motion.positions[:, above]
        if rig.axes is not None:
            path = rotate(inverse(rig.axes[above]), path)
    return RigMotion(rig, motion.rotations, path, motion.positions)


def _rig_of_rest(rest: RestPose, mover: int) -> Rig:
    count, parents = len(rest), np.array(rest.parents)
    offsets = rest.positions - rest.positions[parents]
    offsets[0] = 0.0
    return Rig(
        names=rest.names,
        parents=rest.parents,
        offsets=offsets,
        segments=np.arange(count),
        leaves=tuple(n for n in range(count) if n not in rest.parents),
        root=rest.positions[0],
        axes=rest.axes,
        mover=mover,
    )


class _Node(NamedTuple):
    name: str
    parent: int
    joint: int | None
    segment: int


def _nodes(skeleton: Skeleton, joint: int, parent: int, index: int) -> Iterator[_Node]:
    """Yield a joint's node, the first with the given index, and all below it."""
    children = skeleton.children[joint]
    branches = len(children) > 1 or joint == skeleton.root
    segment = joint if branches or not children else children[0]
    yield _Node(skeleton.joints[joint], parent, joint, segment)
    count = 1
    for child in children:
        above = index
        if branches:
            above = index + count
            yield _Node(f"{skeleton.joints[child]}Pivot", index, None, child)
            count += 1
        for node in _nodes(skeleton, child, above, index + count):
            yield node
            count += 1
