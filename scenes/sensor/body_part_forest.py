"""A random forest that classifies the pixels of a depth image by body part.

Shotton et al. 2011, Real-time human pose recognition in parts from single depth images,
CVPR. A body part is the skin around a joint of Kinect v2. ``pipeline/lab/teach_depth``
trains the trees; this file stores and evaluates them.
"""

from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from os import PathLike
from typing import IO, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V2, Skeleton
from kinefilter.characters.arrays import Array, Codes, Flags, Indices, Singles

from .depth_image import BACKGROUND, DepthImage
from .tracker_errors import V1_NAMES

BODY_PARTS = (*KINECT_V2.joints, "between")
"""Names of the body parts, after the joints at their centers; the last one is skin
between joints."""


def depth_differences(
    image: DepthImage, rows: Indices, columns: Indices, offsets: Array
) -> Singles:
    """Return depth differences [m] around pixels (Shotton et al., eq. 1), (N,).

    For a pixel x of depth d(x), the difference is that between the pixels at
    x + u / d(x) and x + v / d(x), the same places on the body at any distance.
    ``offsets`` (N, 2, 2) are u and v of each pixel [m across the view], each as row and
    column.
    """
    depth = np.pad(image.depth.astype(np.float32), 1, constant_values=BACKGROUND)
    scale = np.float32(image.focal) / depth[rows + 1, columns + 1]
    depths = []
    for offset in (offsets[:, 0], offsets[:, 1]):
        row = np.rint(rows + 1 + scale * offset[:, 0]).astype(np.intp)
        column = np.rint(columns + 1 + scale * offset[:, 1]).astype(np.intp)
        np.clip(row, 0, depth.shape[0] - 1, out=row)
        np.clip(column, 0, depth.shape[1] - 1, out=column)
        depths.append(depth[row, column])
    return np.asarray(depths[0] - depths[1])


@dataclass(frozen=True, eq=False)
class BodyPartForest:
    """A forest that classifies pixels by body part, its nodes numbered across trees."""

    offsets: Singles  # u and v of each feature [m across the view], (F, 2, 2)
    roots: NDArray[np.int32]  # root node of each tree, (T,)
    feature: NDArray[np.int16]  # feature that each node tests, -1 for a leaf, (N,)
    threshold: Singles  # largest difference [m] for going on to the left, (N,)
    children: NDArray[np.int32]  # left and right; for a leaf, its row twice, (N, 2)
    leaves: Codes  # share of each body part in a leaf, scaled to 0..255, (L, P)
    push: Singles
    """Depth of a joint behind the skin, along the ray [m], for the joints of Kinect v1
    and v2, by the body part of the same name, (2, P)."""
    least: Singles  # least visible skin [m^2] for it to be tracked, (2, P)

    def shares(self, image: DepthImage, rows: Indices, columns: Indices) -> Array:
        """Return the probability of each body part at pixels, (N, P)."""
        total = np.zeros((len(rows), self.leaves.shape[1]))
        for root in self.roots:
            nodes = np.full(len(rows), root)
            active = np.arange(len(rows))
            while len(active := active[self.feature[nodes[active]] >= 0]):
                at = nodes[active]
                difference = depth_differences(
                    image, rows[active], columns[active], self.offsets[self.feature[at]]
                )
                side = (difference > self.threshold[at]).astype(int)
                nodes[active] = self.children[at, side]
            total += self.leaves[self.children[nodes, 0]]
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def save(self, file: str | PathLike[str] | IO[bytes]) -> None:
        """Write the arrays to a .npz file."""
        np.savez_compressed(file, **vars(self))

    @classmethod
    def load(cls, file: str | PathLike[str] | IO[bytes]) -> Self:
        """Read a file written by ``save``."""
        with np.load(file, allow_pickle=False) as arrays:
            return cls(**{f.name: arrays[f.name] for f in fields(cls)})


@cache
def shipped_forest() -> BodyPartForest:
    """Return the forest that ships with kinefilter."""
    path = resources.files(__package__).joinpath("embedded/body_parts.npz")
    with path.open("rb") as file:
        return BodyPartForest.load(file)


def parts_of_joints(skeleton: Skeleton) -> Flags:
    """Return which body parts belong to each joint or the one beside it, (P, J)."""
    joints = skeleton.joints
    belongs = np.zeros((len(BODY_PARTS), len(joints)), dtype=bool)
    for p, name in enumerate(KINECT_V2.joints):
        kind = KINECT_V2.kinds[p]
        v1_name = V1_NAMES.get(kind, kind) + name.removeprefix(kind)
        belongs[p, joints.index(name if name in joints else v1_name)] = True
    return belongs
