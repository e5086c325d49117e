"""How the corrector that ships learns its weights: who counts how much."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array, Singles
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.correct.posture_features import Part
from kinefilter.pipeline.correct.random_features import RandomFeatures
from kinefilter.pipeline.progress import Progress, silent

from .lessons import Learner, TrainingSet
from .ridge import Person, own_weights, people_of, ridge_weights

# Chosen by leaving one of six people out, and one of their movements.
_WEIGHT, _SIMULATED_WEIGHT = (
    15000.0,
    150.0,
)  # frames without noise that a person is like
_MOST, _SIMULATED_MOST = 2500, 50  # frames of a person that are learned from
_CENTERS, _PART_CENTERS = 1000, 600  # of the postures that were learned from
# Of limbs on the far side; chosen by leaving one of fourteen people out.
_VIEW_WEIGHT, _VIEW_MOST, _VIEW_CENTERS = 700.0, 1500, 300
_FACING_WEIGHT, _FACING_MOST = 200.0, 800  # of people in front, whom it leaves alone
_ALONE = 3  # so few frames' center would be nearly a recorded posture


class FourierRidgeLearner(FourierRidge, Learner):
    """The corrector before it has learned.

    Args:
        skeleton: The joints.
        samples: Random features of each part in whole takes; live motion has half.
        seed: Draws their frequencies.
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
        """Learn offsets from pairs.

        Args:
            training: People with markers.
            simulated: Simulated people beside them.
            views: People whom a second sensor saw as well, of any skeleton; that is the
                truth of the limbs on the far side of their bodies.
            people: Also learn what each person in ``training`` has alone.
            progress: Wraps the steps, for a progress bar.
        """
        if training.skeleton != self.skeleton or training.person is None:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {self.skeleton.name}"
            )
        recorded = list(people_of(training, _WEIGHT, _MOST))
        if sum(len(person.features) for person in recorded) < 200:
            raise InputError(
                f"{training.source}: {len(training)} frames are too few to learn from; "
                "give 100 or more"
            )
        others = []
        if simulated is not None:
            others = list(people_of(simulated, _SIMULATED_WEIGHT, _SIMULATED_MOST))
        beside, facing = [], []
        if views is not None:
            beside = list(people_of(views, _VIEW_WEIGHT, _VIEW_MOST))
            for person in people_of(training, _FACING_WEIGHT, _FACING_MOST):
                facing.append(replace(person, offsets=np.zeros_like(person.offsets)))
        means = [person.features.mean(axis=0) for person in recorded]
        self.mean_ = np.mean(means, axis=0).astype(np.float16).astype(np.float32)
        parts = self._described.parts
        learned = np.concatenate([part.joints for part in parts])
        means = [person.offsets.mean(axis=0) for person in recorded]
        offset = np.mean(means, axis=0).reshape(-1, 3)[learned]
        self.offset_ = offset.ravel().astype(np.float32)
        self.bones_ = self._odd_bones(training).astype(np.float32)
        self.seed_ = np.array(self.seed)
        features = np.concatenate([p.features for p in (*recorded, *others)])
        self.centers_ = _rounded(_centers_of(features, _CENTERS))
        # Of recorded people alone: what simulated ones do the sensor may not show so.
        known = np.concatenate([person.features for person in recorded])
        self.arm_centers_, self.leg_centers_, self.trunk_centers_ = (
            _rounded(_centers_of(known[:, part.own], _PART_CENTERS)) for part in parts
        )
        self.far_centers_ = np.empty((0, features.shape[1]), dtype=np.float32)
        if beside:
            seen = np.concatenate([person.features for person in beside])
            self.far_centers_ = _rounded(_centers_of(seen, _VIEW_CENTERS))
        self.people_ = np.array(training.people if people else (), dtype=np.str_)
        # Frames are alike: half as many features as frames are plenty.
        most = min(self.samples, len(features) // 2) // 4 * 4
        everybody = [*recorded, *others, *beside, *facing]
        count = 2 * len(parts) * (len(everybody) + 2 * len(self.people_))
        steps = iter(progress("learn", count))

        def weights_of(
            part: Part, columns: NDArray[np.intp], count: int
        ) -> list[Array]:
            """Return the weights of a part: shared, of far sides, of each person."""
            random = RandomFeatures(
                self.mean_[columns], count, self.seed, part.weights[columns]
            )
            people, simulated, aside = (
                [_of_part(person, part.joints) for person in some]
                for some in (recorded, others, beside + facing)
            )
            mean = offset[np.isin(learned, part.joints)].ravel().astype(np.float32)
            shared = ridge_weights(random, columns, people, simulated, mean, steps)
            far, none = shared[:0], np.zeros_like(mean)
            if beside:
                far = ridge_weights(random, columns, aside, [], none, steps)
            own = []
            # With the mirror images, whose left limbs are their right ones.
            for person in people[: 2 * len(self.people_)]:
                next(steps)
                own.append(own_weights(random, columns, person, shared, mean))
            shape = (len(self.people_), 2, len(shared) + 1, len(mean))
            return [shared, far, np.reshape(own, shape)]

        found = []
        for columns, count in (
            (np.arange(features.shape[1]), most),
            (self._described.live, most // 2),
        ):
            told = [weights_of(part, columns, count) for part in parts]
            found.append(
                [_rounded(np.concatenate(w, axis=-1)) for w in zip(*told, strict=True)]
            )
        for _ in steps:
            pass
        (self.weights_, self.far_weights_, self.own_weights_), live = found
        self.live_weights_, self.live_far_weights_, self.live_own_weights_ = live
        self._prepare()
        return self

    def _odd_bones(self, training: TrainingSet) -> Array:
        """Return the mean over people of what ``proportions`` says."""
        if training.lengths is None or training.person is None:
            return np.zeros(len(self._described.limbs))
        people = [training.person == p for p in np.unique(training.person)]
        each = [
            self._described.proportions(np.median(training.lengths[p], 0))
            for p in people
        ]
        return np.asarray(np.mean(each, axis=0))


def _of_part(person: Person, joints: NDArray[np.intp]) -> Person:
    """Return a person with the offsets of some of the known joints."""
    offsets = person.offsets.reshape(len(person.offsets), -1, 3)[:, joints]
    return replace(person, offsets=offsets.reshape(len(offsets), -1))


def _centers_of(features: Singles, count: int) -> Singles:
    """Return centers of the frames; those of a few frames alone are left out."""
    from sklearn.cluster import KMeans

    some = features[np.random.default_rng(0).permutation(len(features))[: 20 * count]]
    count = -(-len(some) // 20)
    means = KMeans(count, init="random", max_iter=10, random_state=0)
    nearest = means.fit_predict(some)
    common = np.bincount(nearest, minlength=count) > _ALONE
    return np.asarray(means.cluster_centers_[common])


def _rounded(values: NDArray[Any]) -> Singles:
    """Return values as a file of half precision has them."""
    return values.astype(np.float16).astype(np.float32)
