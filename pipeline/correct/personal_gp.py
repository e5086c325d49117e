"""The best of what was tried: one Gaussian process, shared by people and personal.

What Kinect gets wrong depends on the posture, on how it is reached, and on the person.
The kernel says so: k(x, x') (1 + k(l, l')) + k(l, l') / 2, with x the posture features
and l the person's segment lengths. People with lengths like those of somebody in the
training data get what was learned on that person; to strangers k(l, l') is near 0, and
what all people share remains.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.reliability import segment_lengths

from .interface import CORRECTED_CONFIDENCE, Correction, Observation
from .learned import LearnedCorrector, TrainingSet

# Chosen by leaving one of six people out; each of them may be halved or doubled at a
# loss of a twentieth of what is gained.
_POSTURE_SCALE = 1.0  # m, over all joints
_PERSON_SCALE = 0.08  # m, over all segments
_NOISE = 0.1  # variance, against a signal of 1
_LOOKING_BACK = 8  # frames, of the movement feature
_MOVEMENT_WEIGHT, _LENGTH_WEIGHT = 0.5, 2.0


class PersonalGP(LearnedCorrector):
    """Adds to each joint the offset to mocap that its posture and person tell.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        seed: Draws them.
    """

    fitted = ("features", "people", "weights", "joints")
    features_: NDArray[np.float32]
    people_: NDArray[np.float32]
    weights_: NDArray[np.float32]

    def __init__(
        self, skeleton: Skeleton, *, samples: int = 6000, seed: int = 0
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed)
        self._lengths = standard_body(skeleton).lengths
        self._past: list[Array] = []

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past = []

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs."""
        if len(training) < 100:
            raise InputError(
                f"{training.source}: {len(training)} frames are too few to learn from; "
                "give 100 or more"
            )
        if training.skeleton != self.skeleton or training.lengths is None:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {self.skeleton.name}"
            )
        known = np.zeros(len(self.skeleton), dtype=bool)
        for some in training.blocks():
            known |= ~np.isnan(training.truth[some, :, 0]).all(axis=0)
        self.joints_ = np.flatnonzero(known)
        generator = np.random.default_rng(self.seed)
        kept = generator.permutation(len(training))[: self.samples]
        chosen = np.zeros(len(training), dtype=bool)
        chosen[kept] = True
        features, offsets = [], []
        for k in progress("learn", len(training)):
            if training.first[k]:
                self.start()
            row = self._features(self._filled(training.positions[k]))
            if chosen[k]:
                features.append(row)
                truth = training.truth[k] - training.positions[k]
                offsets.append(np.nan_to_num(truth[self.joints_]).ravel())
        self.start()
        # Rounded as the file rounds them: a model is the same before and after.
        self.features_ = np.array(features, dtype=np.float32)
        self.people_ = training.lengths[chosen].astype(np.float32)
        kernel = self._kernel(self.features_.astype(float), self.people_.astype(float))
        kernel[np.diag_indices(len(kernel))] += _NOISE
        weights = cho_solve(cho_factor(kernel, overwrite_a=True), np.array(offsets))
        self.weights_ = weights.astype(np.float32)
        return self

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._filled(observation.positions)
        own = observation.lengths
        lengths = self._lengths if own is None else own
        likeness = self._kernel(
            self._features(posture)[None].astype(np.float32),
            lengths[None].astype(np.float32),
        )[0]
        corrected = posture.copy()
        corrected[self.joints_] += (likeness @ self.weights_).reshape(-1, 3)
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(corrected, None, confidence, float(min(1.0, likeness.max())))

    def _filled(self, positions: Array) -> Array:
        return np.asarray(self._hold.fill(positions[None])[0])

    def _features(self, posture: Array) -> Array:
        """Return posture, movement and length features, and remember the posture."""
        points = (posture - posture[self.skeleton.hips].mean(axis=0)).ravel()
        self._past = [*self._past[-_LOOKING_BACK:], points]
        back = self._past[0]
        errors = segment_lengths(posture, self.skeleton) - self._lengths
        return np.concatenate(
            [
                points,
                _MOVEMENT_WEIGHT * (points - back),
                _LENGTH_WEIGHT * errors[self.skeleton.segments],
            ]
        )

    def _kernel(self, features: NDArray[Any], people: NDArray[Any]) -> NDArray[Any]:
        """Return the kernel between some frames and those that were learned from."""
        posture = _gaussian(features, self.features_, _POSTURE_SCALE)
        person = _gaussian(people, self.people_, _PERSON_SCALE)
        return posture * (1.0 + person) + 0.5 * person


def _gaussian(a: NDArray[Any], b: NDArray[Any], scale: float) -> NDArray[Any]:
    """Return exp(-|a - b|^2 / (2 scale^2)) of all rows, shape (len(a), len(b))."""
    squares = np.sum(a * a, axis=1)[:, None] - 2.0 * (a @ b.T) + np.sum(b * b, axis=1)
    return np.asarray(np.exp(np.maximum(squares, 0.0) / (-2.0 * scale**2)))
