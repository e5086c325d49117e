"""The skeleton that animation formats get: every bone length constant, no bend lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Skeleton
from kinefilter.retarget.rotations import inverse, multiply

__all__ = ["Rig", "rig_of"]


@dataclass(frozen=True, eq=False)
class Rig:
    """A tree of nodes, each of which turns all its children together.

    In a clip every segment has a rotation of its own, so the segments that leave one
    joint turn apart. Animation formats let a node turn all that hangs on it. So where
    a joint branches, a node ``<Child>Pivot`` sits in the same place for each child and
    turns with the child's segment; a joint with one child turns with that child's
    segment, a leaf with its own. Nodes are listed depth first.
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
        world = rotations[..., self.segments[node], :]
        parent = self.parents[node]
        if parent < 0:
            return world
        return multiply(inverse(rotations[..., self.segments[parent], :]), world)

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
