"""Which part of a body each pixel of a depth image shows: a forest of random trees.

Shotton et al. 2011, Real-time human pose recognition in parts from single depth images,
CVPR. A body part is the skin around a joint of Kinect v2. Trees are learned by
``pipeline/lab/teach_depth``; here are their numbers, and how pixels go through them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from os import PathLike
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V2, Skeleton
from kinefilter.characters.arrays import Array, Codes, Flags, Indices, Singles

from .depth_image import BACKGROUND, DepthImage
from .tracker_errors import SAME

BODY_PARTS = (*KINECT_V2.joints, "between")
"""Names of the body parts, after the joints in their middle; the last has none."""
_FILE = "embedded/body_parts.npz"


def depth_differences(
    image: DepthImage,
    rows: Indices,
    columns: Indices,
    offsets: Array,
) -> Singles:
    """Return differences of depth [m] around pixels (Shotton et al., eq. 1), (N,).

    Between the pixel u / d(x) away and the one v / d(x) away, where d(x) is the pixel's
    own depth: the farther somebody stands, the nearer to it. So the same place of a
    body has the same difference, wherever the body is.

    Args:
        image: The depth image.
        rows: Of the pixels, (N,).
        columns: Of the pixels, (N,).
        offsets: u and v [m across the view], as rows and columns, (N, 2, 2).
    """
    depth = np.pad(image.depth.astype(np.float32), 1, constant_values=BACKGROUND)
    scale = np.float32(image.focal) / depth[rows + 1, columns + 1]
    found = []
    for offset in (offsets[:, 0], offsets[:, 1]):
        row = np.rint(rows + 1 + scale * offset[:, 0]).astype(np.intp)
        column = np.rint(columns + 1 + scale * offset[:, 1]).astype(np.intp)
        np.clip(row, 0, depth.shape[0] - 1, out=row)
        np.clip(column, 0, depth.shape[1] - 1, out=column)
        found.append(depth[row, column])
    return np.asarray(found[0] - found[1])


@dataclass(frozen=True, eq=False)
class BodyPartForest:
    """A random forest that tells body parts apart, as flat arrays.

    The nodes of all trees are numbered through, tree by tree, and so are the leaves.
    """

    offsets: Singles
    """u and v of each feature [m across the view], (F, 2, 2)."""
    roots: NDArray[np.int32]
    """Node at which each tree begins, (T,)."""
    feature: NDArray[np.int16]
    """Feature that a node looks at, -1: it is a leaf, (N,)."""
    threshold: Singles
    """Greatest difference [m] that goes on to the left, (N,)."""
    children: NDArray[np.int32]
    """Nodes to the left and right; of a leaf, its row in ``leaves`` twice, (N, 2)."""
    leaves: Codes
    """Share of each body part in a leaf, 255: all of it, (L, P)."""
    push: Singles
    """How far behind the skin the joints of Kinect v1 and v2 lie, along the ray [m],
    by the body part of the same name, (2, P)."""
    least: Singles
    """Area of skin [m^2] that must be seen around such a joint for it to be tracked,
    (2, P)."""

    def shares(self, image: DepthImage, rows: Indices, columns: Indices) -> Array:
        """Return the probability of each body part at pixels, (N, P)."""
        found = np.zeros((len(rows), self.leaves.shape[1]))
        for root in self.roots:
            nodes = np.full(len(rows), root)
            going = np.arange(len(rows))
            while len(going := going[self.feature[nodes[going]] >= 0]):
                at = nodes[going]
                offsets = self.offsets[self.feature[at]]
                seen = depth_differences(image, rows[going], columns[going], offsets)
                nodes[going] = self.children[
                    at, (seen > self.threshold[at]).astype(int)
                ]
            found += self.leaves[self.children[nodes, 0]]
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    def save(self, file: str | PathLike[str] | IO[bytes]) -> None:
        """Write the numbers (.npz)."""
        known: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        np.savez_compressed(file, **known)

    @classmethod
    def load(cls, file: str | PathLike[str] | IO[bytes]) -> BodyPartForest:
        """Read what ``save`` wrote."""
        with np.load(file, allow_pickle=False) as arrays:
            return cls(**{f.name: arrays[f.name] for f in fields(cls)})


@cache
def shipped_forest() -> BodyPartForest:
    """Return the forest that comes with kinefilter."""
    path = resources.files(__package__).joinpath(_FILE)
    with path.open("rb") as file:
        return BodyPartForest.load(file)


def parts_of_joints(skeleton: Skeleton) -> Flags:
    """Tell which body parts lie around each joint of a skeleton, (P, J).

    Kinect v1 has no joints of its own in neck, thumb and tips of the hand.
    """
    joints = skeleton.joints
    found = np.zeros((len(BODY_PARTS), len(joints)), dtype=bool)
    for p, name in enumerate(KINECT_V2.joints):
        stem = name.removesuffix("Left").removesuffix("Right")
        side = name.removeprefix(stem)
        known = name if name in joints else SAME.get(stem, stem) + side
        found[p, joints.index(known)] = True
    return found
