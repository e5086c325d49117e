"""Offsets of the sensor's joints from the anatomical ones, constant in the body.

Each is a weighted sum of six vectors that turn with the body: along the segment that
ends at the joint, along the one that starts there, perpendicular to both, and left, up
and forward of the hips. So few weights carry over from simulated people to real ones.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .training_data import OffsetCorrector, TrainingFrames, TrainingSet

_RIDGE = 0.2
"""Penalty on large offsets in training. At half of it, one real person in three ended
up further from the truth than measured; at twice it, a sixth of the gain was lost."""


@dataclass(eq=False, repr=False, kw_only=True)
class JointOffsets(OffsetCorrector):
    """Adds to each joint an offset to mocap that is constant in the body."""

    samples: int = 40_000
    fitted = ("joints", "shares")

    def __post_init__(self) -> None:
        super().__post_init__()
        skeleton = self.skeleton
        root, (left, right) = skeleton.root, skeleton.hips
        # The joint at the end of the segment that starts at each; itself for a leaf.
        first = [next(iter(skeleton.children[j]), j) for j in range(len(skeleton))]
        self._first_children = np.array(first)
        # The segment that ends at each joint (for the root, one that starts there),
        # and the line through the hips.
        self._ends = np.array([*range(len(skeleton)), left])
        self._starts = np.array([*skeleton.parents, right])
        self._ends[root], self._starts[root] = first[root], root

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs, by ridge regression."""
        frames = TrainingFrames.draw(training, self.skeleton, self.samples, self.seed)
        vectors = self._vectors(frames.postures)
        self.joints_ = frames.joints
        self.shares_ = np.empty((len(self.joints_), vectors.shape[-1]))
        for k in progress("learn", len(self.joints_)):
            rows = vectors[:, self.joints_[k]].reshape(-1, vectors.shape[-1])
            gram = rows.T @ rows / len(rows) + _RIDGE * np.eye(rows.shape[1])
            offsets = frames.offsets[:, k].ravel()
            self.shares_[k] = np.linalg.solve(gram, rows.T @ offsets / len(rows))
        return self

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:  # noqa: ARG002 - needs the posture only
        return self.offsets(posture), float("nan")

    def offsets(self, postures: Array) -> Array:
        """Return the learned joints' offsets in postures [m], shape (..., M, 3)."""
        vectors = self._vectors(postures)[..., self.joints_, :, :]
        return np.asarray((vectors @ self.shares_[..., None])[..., 0])

    def _vectors(self, postures: Array) -> Array:
        """Return each joint's six vectors, shape (..., J, 3, 6)."""
        along = unit(postures[..., self._ends, :] - postures[..., self._starts, :])
        ending, across = along[..., :-1, :], along[..., -1:, :]
        starting = ending[..., self._first_children, :]
        girdle = postures[..., self.skeleton.girdle, :]
        spine = girdle - postures[..., self.skeleton.root, :]
        ahead = unit(cross(across, spine[..., None, :]))
        vectors = [ending, starting, cross(ending, starting), across]
        vectors += [cross(ahead, across), ahead]
        return np.stack(np.broadcast_arrays(*vectors), axis=-1)
