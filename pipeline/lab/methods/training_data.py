"""Training data for learned joint offsets, and how offsets are added to a posture."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices, chunks
from kinefilter.pipeline.correct import Correction, Hold, LearnedCorrector, Observation
from kinefilter.pipeline.correct.interface import CORRECTED_CONFIDENCE
from kinefilter.pipeline.progress import Progress, silent

_BLOCK = 100_000  # frames read at a time: 200 MB for the largest skeleton
_LEAST_FRAMES = 100


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Frames on the standard body, root at the origin, facing +z, with ground truth."""

    positions: Array  # measured joint positions [m], NaN where missing, (N, J, 3)
    reliability: Array  # in [0, 1], shape (N, J)
    truth: Array
    """Mocap joint positions [m] in the same frame and scale, NaN where missing, shifted
    so that the hips' midpoint coincides with the measured one, shape (N, J, 3)."""
    first: Flags  # True for the first frame of each take, shape (N,)
    skeleton: Skeleton  # the joints, in the order of the arrays
    source: str  # description of the pairs, for the model file
    lengths: Array  # the person's own segment lengths [m], shape (N, J)
    person: Indices  # index of the person in each frame, shape (N,)
    people: tuple[str, ...]  # names of the people, by index
    time: Array  # stamps [s] within each take, shape (N,)
    sensor: Array  # its position, as in ``Observation``, shape (N, 3)

    def __len__(self) -> int:
        return len(self.positions)

    def check_skeleton(self, skeleton: Skeleton) -> None:
        """Raise an InputError if the frames are not of the skeleton of a model."""
        if self.skeleton != skeleton:
            raise InputError(
                f"{self.source}: pairs of {self.skeleton.name}, but the model is for "
                f"{skeleton.name}"
            )


class Learner(LearnedCorrector, ABC):
    """A correction method that can be trained."""

    @abstractmethod
    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs; InputError if they are too few or of another skeleton."""


@dataclass(eq=False, repr=False, kw_only=True)
class OffsetCorrector(Learner):
    """Fills missing joints, then adds an offset to each joint."""

    skeleton: Skeleton = field(kw_only=False)
    samples: int  # maximum number of training frames
    seed: int = 0  # seed for drawing the training frames

    def __post_init__(self) -> None:
        super().__init__(self.skeleton)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        offsets, coverage = self._offsets(posture, observation)
        return self._moved(posture, offsets, missing, coverage)

    def _moved(
        self, posture: Array, offsets: Array, missing: Flags, coverage: float
    ) -> Correction:
        """Return a posture (J, 3) with the learned joints moved by offsets (M, 3) [m].

        Joints that are ``missing`` (J,), and filled, move with their parents.
        """
        learned, skeleton = self.joints_, self.skeleton
        corrected = posture.copy()
        corrected[learned] += np.where(missing[learned, None], 0.0, offsets)
        for j in skeleton.order[1:] if missing.any() else ():
            if missing[j]:
                parent = skeleton.parents[j]
                corrected[j] = corrected[parent] + posture[j] - posture[parent]
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(corrected, confidence, coverage)

    @abstractmethod
    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        """Return offsets [m] of the learned joints, shape (M, 3), and the coverage."""


@dataclass(frozen=True, eq=False)
class TrainingFrames:
    """Frames in which every learned joint is both measured and in the ground truth."""

    postures: Array  # measured joints [m], missing ones filled, shape (N, J, 3)
    offsets: Array  # mocap minus Kinect [m] at the learned joints, shape (N, M, 3)
    joints: Indices  # learned ones: those that mocap and Kinect both have, (M,)
    measured: Flags  # the joints that Kinect has, shape (J,)
    lengths: Array  # of the person's segments [m], by Kinect, shape (N, J)

    @classmethod
    def draw(
        cls,
        training: TrainingSet,
        skeleton: Skeleton,
        samples: int,
        seed: int,
        least_reliability: float = 0.0,
    ) -> Self:
        """Draw frames whose upper body has a reliability; InputError if too few.

        The legs need none: Chiang et al., whose rule it is, have only the upper body.
        """
        training.check_skeleton(skeleton)
        counts = np.zeros((2, len(skeleton)))
        for block in chunks(len(training), _BLOCK):
            measured = ~np.isnan(training.positions[block, :, 0])
            both = measured & ~np.isnan(training.truth[block, :, 0])
            counts += [measured.sum(axis=0), both.sum(axis=0)]
        # Requiring a joint that is mostly absent would leave too few frames.
        usual, common = counts / len(training) > 0.5
        joints = np.flatnonzero(common)
        legs = np.isin(joints, [*skeleton.hips, *skeleton.legs])
        least = np.where(legs, 0.0, least_reliability)
        rows = _complete_frames(training, joints, least)
        if len(rows) < _LEAST_FRAMES or not len(joints):
            raise InputError(
                f"{training.source}: {len(rows)} frames with every joint reliable "
                "and in both recordings are too few to train on; give "
                f"{_LEAST_FRAMES} or more"
            )
        rows = np.random.default_rng(seed).permutation(rows)[:samples]
        # Single precision, as in a model file, so that saving changes nothing.
        postures = training.positions[rows].astype(np.float32).astype(float)
        offsets = training.truth[rows] - training.positions[rows]
        offsets = offsets[:, joints].astype(np.float32).astype(float)
        hold = Hold(skeleton)
        for row in np.flatnonzero(np.isnan(postures).any(axis=(1, 2))):
            hold.start()
            postures[row] = hold.fill(postures[row][None])[0]
        lengths = training.lengths[rows].astype(np.float32).astype(float)
        return cls(postures, offsets, joints, usual, lengths)


def _complete_frames(training: TrainingSet, joints: Indices, least: Array) -> Indices:
    frames = []
    for block in chunks(len(training), _BLOCK):
        complete = training.reliability[block][:, joints] >= least
        for positions in (training.positions, training.truth):
            complete &= ~np.isnan(positions[block][:, joints, 0])
        frames.append(block.start + np.flatnonzero(complete.all(axis=1)))
    return np.concatenate(frames)
