"""Training of the shipped corrector, and how much each group of people counts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array, Indices, Singles
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.correct.posture_features import Part
from kinefilter.pipeline.correct.random_features import RandomFeatures
from kinefilter.pipeline.progress import Progress, silent

from .ridge import Person, own_weights, people_in, ridge_weights
from .training_data import Learner, TrainingSet

# Weight and maximum number of a person's frames, as in ``people_in``, for recorded and
# simulated people, and numbers of centers of the training postures. Chosen by leaving
# one of six people out, and one of their movements.
_WEIGHT, _MOST = 15000.0, 2500
_SIMULATED_WEIGHT, _SIMULATED_MOST = 150.0, 50
_CENTERS, _PART_CENTERS = 1000, 600
# For limbs on the far side of the body; chosen by leaving one of fourteen people out.
_VIEW_WEIGHT, _VIEW_MOST, _VIEW_CENTERS = 700.0, 1500, 300
_FACING_WEIGHT, _FACING_MOST = 200.0, 800  # people facing the sensor: zero offsets
_ALONE = 3  # frames whose center would be nearly a recorded posture, and is left out


class FourierRidgeLearner(FourierRidge, Learner):
    """The shipped corrector with its training.

    Args:
        samples: Number of random features per part for whole takes; live motion has
            half as many.
        seed: Seed of their frequencies.
    """

    def __init__(
        self, skeleton: Skeleton, *, samples: int = 2048, seed: int = 0
    ) -> None:
        super().__init__(skeleton)
        self.samples, self.seed = samples, seed

    def fit(
        self,
        training: TrainingSet,
        *,
        simulated: TrainingSet | None = None,
        views: TrainingSet | None = None,
        people: bool = False,
        progress: Progress = silent,
    ) -> Self:
        """Train on pairs.

        Args:
            training: People recorded with markers.
            simulated: Simulated people in addition.
            views: People recorded by a second sensor as well, of any skeleton; it gives
                the ground truth of the limbs on the far side of their bodies.
            people: Also learn each person's own effects in ``training``.
            progress: Wraps the steps, for a progress bar.
        """
        if training.skeleton != self.skeleton or training.person is None:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {self.skeleton.name}"
            )
        recorded = list(people_in(training, _WEIGHT, _MOST))
        if sum(len(person.features) for person in recorded) < 200:
            raise InputError(
                f"{training.source}: {len(training)} frames are too few to train on; "
                "give 100 or more"
            )
        others, aside = list[Person](), list[Person]()
        self.far_centers_ = np.empty((0, recorded[0].features.shape[1]), np.float32)
        if simulated is not None:
            others += people_in(simulated, _SIMULATED_WEIGHT, _SIMULATED_MOST)
        if views is not None:
            aside += people_in(views, _VIEW_WEIGHT, _VIEW_MOST)
            centers = _centers_of(_features_of(aside), _VIEW_CENTERS)
            self.far_centers_ = _half_precision(centers)
            for person in people_in(training, _FACING_WEIGHT, _FACING_MOST):
                aside.append(replace(person, offsets=np.zeros_like(person.offsets)))
        means = [person.features.mean(axis=0) for person in recorded]
        self.mean_ = np.mean(means, axis=0).astype(np.float16).astype(np.float32)
        parts = self._posture_features.parts
        learned = np.concatenate([part.joints for part in parts])
        means = [person.offsets.mean(axis=0) for person in recorded]
        offset = np.mean(means, axis=0).reshape(-1, 3)[learned]
        self.offset_ = offset.ravel().astype(np.float32)
        self.bones_ = self._mean_proportions(training).astype(np.float32)
        self.seed_ = np.array(self.seed)
        features = _features_of(recorded + others)
        self.centers_ = _half_precision(_centers_of(features, _CENTERS))
        # Of recorded people only: the sensor may not show what simulated people do.
        known = _features_of(recorded)
        self.arm_centers_, self.leg_centers_, self.trunk_centers_ = (
            _half_precision(_centers_of(known[:, part.own], _PART_CENTERS))
            for part in parts
        )
        self.people_ = np.array(training.people if people else (), dtype=np.str_)
        # Frames are similar to each other: half as many features as frames are plenty.
        most = min(self.samples, len(features) // 2) // 4 * 4
        count = len(recorded) + len(others) + len(aside) + 2 * len(self.people_)
        steps = iter(progress("learn", 2 * len(parts) * count))

        def weights_of(part: Part, columns: Indices, count: int) -> list[Array]:
            """Return a part's weights: shared, of the far side, of each person."""
            random = RandomFeatures(
                self.mean_[columns], count, self.seed, part.weights[columns]
            )
            mean = offset[np.isin(learned, part.joints)].ravel().astype(np.float32)
            people, simulated, beside = (
                [_of_part(person, part, columns, less) for person in group]
                for group, less in ((recorded, mean), (others, mean), (aside, 0.0))
            )
            shared = ridge_weights(random, people, simulated, steps)
            far = ridge_weights(random, beside, [], steps) if beside else shared[:0]
            own = []
            # Each person is followed by their mirror image, for the right limbs.
            for person in people[: 2 * len(self.people_)]:
                next(steps)
                own.append(own_weights(random, person, shared))
            shape = (len(self.people_), 2, len(shared) + 1, len(mean))
            return [shared, far, np.reshape(own, shape)]

        def all_weights(columns: Indices, count: int) -> list[Singles]:
            """Return the same for all parts, side by side."""
            by_part = [weights_of(part, columns, count) for part in parts]
            return [
                _half_precision(np.concatenate(weights, axis=-1))
                for weights in zip(*by_part, strict=True)
            ]

        whole = all_weights(np.arange(features.shape[1]), most)
        live = all_weights(self._posture_features.live, most // 2)
        for _ in steps:
            pass
        self.weights_, self.far_weights_, self.own_weights_ = whole
        self.live_weights_, self.live_far_weights_, self.live_own_weights_ = live
        self._prepare()
        return self

    def _mean_proportions(self, training: TrainingSet) -> Array:
        """Return the mean over people of ``PostureFeatures.proportions``."""
        if training.lengths is None or training.person is None:
            return np.zeros(len(self._posture_features.limbs))
        each = []
        for person in np.unique(training.person):
            lengths = training.lengths[training.person == person]
            each.append(self._posture_features.proportions(np.median(lengths, 0)))
        return np.asarray(np.mean(each, axis=0))


def _features_of(people: list[Person]) -> Singles:
    return np.concatenate([person.features for person in people])


def _of_part(
    person: Person, part: Part, columns: Indices, mean: Singles | float
) -> Person:
    """Return a person's frames for one part, less a mean offset [m]."""
    offsets = person.offsets.reshape(len(person.offsets), -1, 3)[:, part.joints]
    offsets = offsets.reshape(len(offsets), -1) - mean
    return replace(person, features=person.features[:, columns], offsets=offsets)


def _centers_of(features: Singles, count: int) -> Singles:
    """Return k-means centers of frames, without the centers of only a few frames."""
    from sklearn.cluster import KMeans

    some = features[np.random.default_rng(0).permutation(len(features))[: 20 * count]]
    count = -(-len(some) // 20)
    means = KMeans(count, init="random", max_iter=10, random_state=0)
    nearest = means.fit_predict(some)
    common = np.bincount(nearest, minlength=count) > _ALONE
    return np.asarray(means.cluster_centers_[common])


def _half_precision(values: NDArray[Any]) -> Singles:
    """Return values rounded to half precision, as a model file stores them."""
    return values.astype(np.float16).astype(np.float32)
