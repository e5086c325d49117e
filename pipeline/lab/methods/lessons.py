"""What the methods that add offsets to joints learn from, and how they add them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Hold, LearnedCorrector, Observation
from kinefilter.pipeline.correct.interface import CORRECTED_CONFIDENCE
from kinefilter.pipeline.progress import Progress, silent

_BLOCK = 100_000  # frames looked at at a time; 200 MB of the largest skeleton
_LEAST_FRAMES = 100


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Frames on the standard body, root at the origin, facing +z, and their truth."""

    positions: Array
    """Measured joint positions [m], NaN where missing, shape (N, J, 3)."""
    reliability: Array
    """Reliability in [0, 1], shape (N, J)."""
    truth: Array
    """Mocap's joint positions [m] in the same view and scale, NaN where none; moved so
    that the hips' middle is where the measurement has it, shape (N, J, 3)."""
    first: NDArray[np.bool_]
    """The frame begins a take, shape (N,)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str
    """What the pairs are, for the model file."""
    lengths: Array | None = None
    """The person's own segment lengths in each frame [m], shape (N, J)."""
    person: NDArray[np.intp] | None = None
    """Whose frame it is, by number, shape (N,)."""
    people: tuple[str, ...] = ()
    """Their names, by number."""
    time: Array | None = None
    """Time stamps [s] within each take, shape (N,); None: 30 frames a second."""
    sensor: Array | None = None
    """Where the sensor is, as in ``Observation``, shape (N, 3)."""

    def __len__(self) -> int:
        return len(self.positions)


class Learner(LearnedCorrector, ABC):
    """A correction method that can be taught."""

    @abstractmethod
    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn from pairs.

        Raises:
            InputError: The pairs are too few, or of another skeleton.
        """


class OffsetCorrector(Learner):
    """Adds offsets to the joints, and fills missing ones beforehand.

    Args:
        skeleton: The joints.
        samples: Most training frames that are used.
        seed: Draws them.
    """

    def __init__(self, skeleton: Skeleton, *, samples: int, seed: int) -> None:
        super().__init__(skeleton)
        self.samples, self.seed = samples, seed

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        offsets, coverage = self._offsets(posture, observation)
        return add_offsets(
            self.skeleton, posture, self.joints_, offsets, missing, coverage
        )

    @abstractmethod
    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        """Return offsets [m] of the learned joints, shape (M, 3), and the coverage."""


@dataclass(frozen=True, eq=False)
class Lessons:
    """Frames of a training set in which both have every joint that is learned."""

    postures: Array
    """Measured joint positions [m], finite, shape (N, J, 3)."""
    offsets: Array
    """Mocap less Kinect [m] of the learned joints, shape (N, M, 3)."""
    learned: NDArray[np.intp]
    """The joints that mocap and Kinect both have, shape (M,)."""
    seen: NDArray[np.bool_]
    """The joints that Kinect has, shape (J,)."""
    lengths: Array
    """The person's own segment lengths [m], as Kinect has them, shape (N, J)."""

    @classmethod
    def drawn(
        cls,
        training: TrainingSet,
        skeleton: Skeleton,
        samples: int,
        seed: int,
        *,
        above: float = 0.0,
    ) -> Self:
        """Draw at most ``samples`` frames at random.

        Every joint to be learned has at least the reliability ``above``.

        Raises:
            InputError: They are too few, or of another skeleton.
        """
        if training.skeleton != skeleton:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {skeleton.name}"
            )
        counts = np.zeros((2, len(skeleton)))
        for some in _blocks(training):
            measured = ~np.isnan(training.positions[some, :, 0])
            both = measured & ~np.isnan(training.truth[some, :, 0])
            counts += [measured.sum(axis=0), both.sum(axis=0)]
        # A joint that is mostly absent would cost the others their frames.
        seen, common = counts / len(training) > 0.5
        learned = np.flatnonzero(common)
        rows = _frames_with(training, learned, above)
        if len(rows) < _LEAST_FRAMES or not len(learned):
            raise InputError(
                f"{training.source}: {len(rows)} frames with every joint reliable "
                "and in both recordings are too few to learn from; give "
                f"{_LEAST_FRAMES} or more"
            )
        rows = np.random.default_rng(seed).permutation(rows)[:samples]
        # Rounded as a model file rounds: a model is the same before and after.
        postures = training.positions[rows].astype(np.float32).astype(float)
        offsets = training.truth[rows] - training.positions[rows]
        offsets = offsets[:, learned].astype(np.float32).astype(float)
        hold = Hold(skeleton)
        for row in np.flatnonzero(np.isnan(postures).any(axis=(1, 2))):
            hold.start()
            postures[row] = hold.fill(postures[row][None])[0]
        lengths = (
            np.tile(standard_body(skeleton).lengths, (len(rows), 1))
            if training.lengths is None
            else training.lengths[rows].astype(np.float32).astype(float)
        )
        return cls(postures, offsets, learned, seen, lengths)


def _frames_with(
    training: TrainingSet, joints: NDArray[np.intp], above: float
) -> NDArray[np.intp]:
    """Return the frames in which both have all joints, at a reliability or more."""
    frames = []
    for some in _blocks(training):
        whole = training.reliability[some][:, joints] >= above
        for positions in (training.positions, training.truth):
            whole &= ~np.isnan(positions[some][:, joints, 0])
        frames.append(some.start + np.flatnonzero(whole.all(axis=1)))
    return np.concatenate(frames)


def add_offsets(
    skeleton: Skeleton,
    posture: Array,
    learned: NDArray[np.intp],
    offsets: Array,
    missing: NDArray[np.bool_],
    coverage: float,
) -> Correction:
    """Return postures moved by offsets; missing joints go along with their parents.

    Args:
        skeleton: The joints.
        posture: Joint positions [m], filled where missing, shape (..., J, 3).
        learned: The joints that have offsets, shape (M,).
        offsets: Shape (..., M, 3) [m].
        missing: Nothing was measured, shape (..., J).
        coverage: How well the method knows the posture, in [0, 1].
    """
    corrected = posture.copy()
    known = ~missing[..., learned, None]
    corrected[..., learned, :] += np.where(known, offsets, 0.0)
    for j in skeleton.order[1:] if missing.any() else ():
        parent = skeleton.parents[j]
        hung = corrected[..., parent, :] + posture[..., j, :] - posture[..., parent, :]
        lost = missing[..., j, None]
        corrected[..., j, :] = np.where(lost, hung, corrected[..., j, :])
    confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
    return Correction(corrected, None, confidence, coverage)


def _blocks(training: TrainingSet) -> Iterator[slice]:
    """Yield slices of the frames, so that a part at a time is in memory."""
    for start in range(0, len(training), _BLOCK):
        yield slice(start, min(start + _BLOCK, len(training)))
