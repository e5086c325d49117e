"""Training of the shipped corrector: ridge regression, people as random effects."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array, Indices, Singles
from kinefilter.characters.rotations import wrapped
from kinefilter.pipeline.correct import Hold
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.correct.posture_features import (
    Part,
    PostureFeatures,
    RandomFeatures,
    direction_to,
    turned_away,
)
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget import find_yaw

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
# Variances of random effects and noise, relative to 1 for what all people share.
_SHARE = 0.07  # a: of the effect of a person or a clip
_SIMULATED_SHARE = 0.05  # of the effect that all simulated people have in common
_OWN, _OWN_CLIP, _OWN_NOISE = 3.0, 0.03, 0.1  # for a known person's own weights
_LEAST_NOISE = 0.1  # of the noise in a frame
_BATCH = 2048  # rows whose products are summed at a time
_ALONE = 3  # frames whose center would be nearly a recorded posture, and is left out


@dataclass(frozen=True, eq=False)
class Person:
    """Training frames of one person, or their mirror images."""

    features: Singles  # features of the postures, shape (N, F)
    offsets: Array  # offsets of the known joints [m], flattened, shape (N, 3 M)
    clips: Indices  # index of the clip of each frame, shape (N,)
    noise: float  # variance of the noise in a frame


def people_in(training: TrainingSet, weight: float, most: int) -> Iterator[Person]:
    """Yield all recorded people, each followed by their mirror image.

    The variance of the noise in a frame is the number of a person's frames, of which at
    most ``most`` are used, over their total ``weight``.
    """
    features = PostureFeatures(training.skeleton)
    clip = np.cumsum(training.first) - 1
    for person in np.unique(training.person):
        rows = np.flatnonzero(training.person == person)
        bounds = np.flatnonzero(np.diff(clip[rows], prepend=-1, append=-1))
        takes = [_take(training, rows[a:b], features) for a, b in pairwise(bounds)]
        step = -(-sum(len(take.known) for take in takes) // most)
        # Start at a different frame in each clip.
        chosen = [take.known[k % step :: step] for k, take in enumerate(takes)]
        sizes = [len(frames) for frames in chosen]
        for mirrored in (False, True):
            inputs, outputs = [], []
            for take, frames in zip(takes, chosen, strict=True):
                points, offsets, toward = take.points, take.offsets, take.toward
                if mirrored:
                    points, offsets = map(features.mirrored, (points, offsets))
                    toward = toward * [-1.0, 1.0]
                shown, now = points[frames], take.time[frames]
                inputs.append(features(shown, points, now, take.time, toward[frames]))
                outputs.append(offsets[frames].reshape(len(frames), -1))
            yield Person(
                np.concatenate(inputs),
                np.concatenate(outputs),
                np.repeat(np.arange(len(sizes)), sizes),
                max(_LEAST_NOISE, sum(sizes) / weight),
            )


class _Take(NamedTuple):
    points: Array
    offsets: Array
    toward: Array
    time: Array
    known: Indices  # the frames that have ground truth


def _take(training: TrainingSet, rows: Indices, features: PostureFeatures) -> _Take:
    posture = Hold(training.skeleton).fill(training.positions[rows])
    offsets = (training.truth[rows] - posture)[:, features.joints]
    # A joint that mocap lost for a while gets its mean offset in the clip.
    known = ~np.isnan(offsets)
    mean = np.where(known, offsets, 0.0).sum(axis=0) / np.maximum(known.sum(0), 1)
    return _Take(
        features.points(posture),
        np.where(known, offsets, mean),
        direction_to(training.sensor[rows], len(rows)),
        training.time[rows],
        np.flatnonzero(known.any(axis=(1, 2))),
    )


def ridge_weights(
    random: RandomFeatures,
    recorded: list[Person],
    simulated: list[Person],
    steps: Iterator[int],
) -> Array:
    """Return the weights that all people share, with random effects marginalized."""
    size = random.size + 1
    information = np.zeros((size, size), dtype=np.float32, order="F")
    products = np.zeros((size, recorded[0].offsets.shape[1]))
    _add(information, products, random, simulated, steps)
    if simulated:
        # The effect that all of them share: (I + aG)^-1 G = (I - (I + aG)^-1) / a.
        total = _symmetric(information).astype(float) * _SIMULATED_SHARE
        total[np.diag_indices(size)] += 1.0
        factor = cho_factor(total, overwrite_a=True)
        products = cho_solve(factor, products)
        inverse = cho_solve(factor, np.eye(size), overwrite_b=True)
        inverse[np.diag_indices(size)] -= 1.0
        information = np.asfortranarray(inverse / -_SIMULATED_SHARE, dtype=np.float32)
    _add(information, products, random, recorded, steps)
    total = _symmetric(information).astype(float)[:-1, :-1]
    total[np.diag_indices(size - 1)] += 1.0
    return np.asarray(cho_solve(cho_factor(total, overwrite_a=True), products[:-1]))


def own_weights(random: RandomFeatures, person: Person, shared: Array) -> Array:
    """Return a person's own weights on top of the shared ones, a constant last."""
    rows, products, same_clip = _design(random, person)
    covariance = _OWN * products + _OWN_CLIP * same_clip
    covariance[np.diag_indices(len(rows))] += _OWN_NOISE
    residuals = person.offsets - rows[:, :-1] @ shared
    factor = cho_factor(covariance, overwrite_a=True)
    return np.asarray(_OWN * rows.T @ cho_solve(factor, residuals))


def _add(
    information: Singles,
    products: Array,
    random: RandomFeatures,
    people: list[Person],
    steps: Iterator[int],
) -> None:
    """Add people's normal equations, for weights and a constant, in place."""
    waiting: list[Singles] = []
    for person in people:
        next(steps)
        rows, offsets = _whitened(random, person)
        products += rows.T @ offsets
        waiting.append(rows)
        if person is people[-1] or sum(map(len, waiting)) > _BATCH:
            rows, waiting = np.concatenate(waiting), []
            blas.ssyrk(1.0, rows.T, beta=1.0, c=information, overwrite_c=1)


def _whitened(random: RandomFeatures, person: Person) -> tuple[Singles, Singles]:
    """Return a person's features and offsets, whitened by the frames' covariance."""
    rows, products, same_clip = _design(random, person)
    covariance = _SHARE * (products + same_clip)
    covariance[np.diag_indices(len(rows))] += person.noise
    factor = cholesky(covariance, lower=True, overwrite_a=True).astype(np.float32)
    both = np.hstack([rows, person.offsets.astype(np.float32)])
    solved = solve_triangular(factor, both, lower=True, overwrite_b=True)
    white = solved.astype(np.float32, copy=False)
    return white[:, : random.size + 1], white[:, random.size + 1 :]


def _design(random: RandomFeatures, person: Person) -> tuple[Singles, Array, Array]:
    """Return random features with a constant, their products, and 1 per equal clip."""
    rows = np.ones((len(person.features), random.size + 1), dtype=np.float32)
    rows[:, :-1] = random(person.features)
    same_clip = (person.clips[:, None] == person.clips).astype(float)
    return rows, (rows @ rows.T).astype(float), same_clip


def _symmetric(upper: Singles) -> Singles:
    return np.asarray(upper + np.triu(upper, 1).T)


@dataclass(eq=False, repr=False, kw_only=True)
class FourierRidgeLearner(FourierRidge, Learner):
    """The shipped corrector with its training."""

    skeleton: Skeleton = field(kw_only=False)
    samples: int = 2048  # random features per part; half of them in live motion
    seed: int = 0  # seed of their frequencies

    def __post_init__(self) -> None:
        super().__init__(self.skeleton)

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

        ``training`` are people recorded with markers, ``simulated`` others in addition.
        ``views`` are people recorded by a second sensor as well, of any skeleton, for
        the limbs on the far side of their bodies and their heading. With ``people``,
        each person's own effects in ``training`` are learned, too.
        """
        training.check_skeleton(self.skeleton)
        recorded = list(people_in(training, _WEIGHT, _MOST))
        if sum(len(person.features) for person in recorded) < 200:
            raise InputError(
                f"{training.source}: {len(training)} frames are too few to train on; "
                "give 100 or more"
            )
        others, aside = list[Person](), list[Person]()
        self.far_centers_ = np.empty((0, recorded[0].features.shape[1]), np.float32)
        self.turn_share_ = np.array(0.0 if views is None else _turn_share(views))
        if simulated is not None:
            others += people_in(simulated, _SIMULATED_WEIGHT, _SIMULATED_MOST)
        if views is not None:
            aside += people_in(views, _VIEW_WEIGHT, _VIEW_MOST)
            centers = centers_of(_features_of(aside), _VIEW_CENTERS)
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
        self.centers_ = _half_precision(centers_of(features, _CENTERS))
        # Of recorded people only: the sensor may not show what simulated people do.
        known = _features_of(recorded)
        self.arm_centers_, self.leg_centers_, self.trunk_centers_ = (
            _half_precision(centers_of(known[:, part.own], _PART_CENTERS))
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
        each = []
        for person in np.unique(training.person):
            lengths = training.lengths[training.person == person]
            each.append(self._posture_features.proportions(np.median(lengths, 0)))
        return np.asarray(np.mean(each, axis=0))


def _turn_share(views: TrainingSet) -> float:
    """Return the share by which people turn farther than shown, by least squares."""
    shown = turned_away(direction_to(views.sensor, len(views)))
    both = (views.truth, views.positions)
    true_yaw, seen_yaw = (find_yaw(places, views.skeleton) for places in both)
    turn = wrapped(true_yaw - seen_yaw)
    known = np.isfinite(turn) & (shown != 0.0)
    if not known.any():
        return 0.0
    share = shown[known] @ turn[known] / (shown[known] @ shown[known])
    return float(np.clip(share, 0.0, 1.0))


def _features_of(people: list[Person]) -> Singles:
    return np.concatenate([person.features for person in people])


def _of_part(
    person: Person, part: Part, columns: Indices, mean: Singles | float
) -> Person:
    offsets = person.offsets.reshape(len(person.offsets), -1, 3)[:, part.joints]
    offsets = offsets.reshape(len(offsets), -1) - mean
    return replace(person, features=person.features[:, columns], offsets=offsets)


def centers_of(features: Singles, count: int) -> Singles:
    """Return k-means centers of frames, without the centers of only a few frames."""
    from sklearn.cluster import KMeans

    some = features[np.random.default_rng(0).permutation(len(features))[: 20 * count]]
    count = -(-len(some) // 20)
    means = KMeans(count, init="random", max_iter=10, random_state=0)
    common = np.bincount(means.fit_predict(some), minlength=count) > _ALONE
    return np.asarray(means.cluster_centers_[common])


def _half_precision(values: NDArray[Any]) -> Singles:
    return values.astype(np.float16).astype(np.float32)
