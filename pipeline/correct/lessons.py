"""What the methods that learn offsets share: examples, and how offsets are added."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct.interface import TrainingSet

from .hold import Hold
from .interface import CORRECTED_TRUST, Correction, Observation

_LEAST_FRAMES = 100


@dataclass(frozen=True, eq=False)
class Lessons:
    """Frames of a training set in which every joint to be learned is there twice."""

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

        Args:
            training: Where to draw from.
            skeleton: The joints of the model.
            samples: Most frames.
            seed: Of the draw.
            above: Least rate of every joint to be learned.

        Raises:
            InputError: They are too few, or of another skeleton.
        """
        if training.skeleton != skeleton:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {skeleton.name}"
            )
        seen, both = _shares(training)
        # A joint that is mostly absent would cost the others their frames.
        learned = np.flatnonzero(both > 0.5)
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
        ones = np.ones(len(skeleton))
        for row in np.flatnonzero(np.isnan(postures).any(axis=(1, 2))):
            hold.start()
            measured = Observation(postures[row], ones, ones)
            postures[row] = hold.step(measured).positions
        lengths = (
            np.tile(standard_body(skeleton).lengths, (len(rows), 1))
            if training.lengths is None
            else training.lengths[rows].astype(np.float32).astype(float)
        )
        return cls(postures, offsets, learned, seen > 0.5, lengths)


def _shares(training: TrainingSet) -> tuple[Array, Array]:
    """Return in how many of the frames Kinect, and mocap too, has each joint, (J,)."""
    seen = np.zeros((2, len(training.skeleton)))
    for some in training.blocks():
        measured = ~np.isnan(training.positions[some, :, 0])
        both = measured & ~np.isnan(training.truth[some, :, 0])
        seen += [measured.sum(axis=0), both.sum(axis=0)]
    seen /= len(training)
    return seen[0], seen[1]


def _frames_with(
    training: TrainingSet, joints: NDArray[np.intp], above: float
) -> NDArray[np.intp]:
    """Return the frames in which both have all of some joints, at a rate or more."""
    frames = []
    for some in training.blocks():
        whole = training.rate[some][:, joints] >= above
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
    return Correction(
        corrected, None, np.where(missing, 0.0, CORRECTED_TRUST), coverage
    )
