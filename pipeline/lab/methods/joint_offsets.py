"""Where the sensor's joints lie in the body: offsets that turn with its segments.

A tracker's joints are not the joint centers of anatomy; most of a Kinect's error is
that they are some centimeters off, always on the same side of the limb. So each
joint's offset is a sum of six vectors that turn with the body: along the segment that
ends at the joint, along the one that starts there, across both, and left, up and ahead
of the hips. Six numbers a joint are so few that what is learned on simulated people
holds for real ones.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .lessons import Lessons, OffsetCorrector, TrainingSet

_RIDGE = 0.2
"""Weight against large offsets, with simulated people as teachers: at half of it one
real person in three moved less truly than as measured, at twice it a sixth of what is
gained was lost (the people that the virtual Kinect is calibrated to)."""


class JointOffsets(OffsetCorrector):
    """Adds to each joint the offset to mocap that is constant in the body.

    Args:
        skeleton: The joints.
        samples: Most training frames that are used.
        seed: Draws them.
    """

    fitted = ("joints", "shares")
    shares_: Array

    def __init__(
        self, skeleton: Skeleton, *, samples: int = 40_000, seed: int = 0
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed)
        root, (left, right) = skeleton.root, skeleton.hips
        first = [next(iter(skeleton.children[j]), j) for j in range(len(skeleton))]
        # The segment that starts at a joint; a leaf has one segment only.
        self._starting = np.array(first)
        # The segment that ends at each joint, the root's being one that starts there,
        # and the line through the hips.
        self._ends = np.array([*range(len(skeleton)), left])
        self._starts = np.array([*skeleton.parents, right])
        self._ends[root], self._starts[root] = first[root], root

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs, by ridge regression."""
        lessons = Lessons.drawn(training, self.skeleton, self.samples, self.seed)
        vectors = self._vectors(lessons.postures)
        self.joints_ = lessons.learned
        self.shares_ = np.empty((len(self.joints_), vectors.shape[-1]))
        for k in progress("learn", len(self.joints_)):
            sides = vectors[:, self.joints_[k]].reshape(-1, vectors.shape[-1])
            gram = sides.T @ sides / len(sides) + _RIDGE * np.eye(sides.shape[1])
            wanted = lessons.offsets[:, k].ravel()
            self.shares_[k] = np.linalg.solve(gram, sides.T @ wanted / len(sides))
        return self

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:  # noqa: ARG002 - of the posture alone
        return self.offsets(posture), float("nan")

    def offsets(self, postures: Array) -> Array:
        """Return the learned joints' offsets in postures [m], shape (..., M, 3)."""
        vectors = self._vectors(postures)[..., self.joints_, :, :]
        return np.asarray((vectors @ self.shares_[..., None])[..., 0])

    def _vectors(self, postures: Array) -> Array:
        """Return six vectors a joint that turn with the body, shape (..., J, 3, 6)."""
        along = unit(postures[..., self._ends, :] - postures[..., self._starts, :])
        ending, across = along[..., :-1, :], along[..., -1:, :]
        starting = ending[..., self._starting, :]
        girdle = postures[..., self.skeleton.girdle, :]
        spine = girdle - postures[..., self.skeleton.root, :]
        ahead = unit(cross(across, spine[..., None, :]))
        vectors = np.empty((*postures.shape, 6))
        vectors[..., 0] = ending
        vectors[..., 1] = starting
        vectors[..., 2] = cross(ending, starting)
        vectors[..., 3] = across
        vectors[..., 4] = cross(ahead, across)
        vectors[..., 5] = ahead
        return vectors
