"""The learned corrector: a Gaussian process over posture and movement, as weights.

The kernel k(x, x') = exp(-|x - x'|^2 / 2) + 0.4 x.x' is a product of features:
Fourier's at random, orthogonal frequencies (Yu et al. 2016, Orthogonal random features,
NeurIPS) and the linear ones. So a model is a matrix of weights, and nobody's recording.
What is constant in a person or a clip, and what one person alone has with a posture,
are random effects in the training covariance, k (1 + a p) + a p + a c with p and c one
for the same person and clip: strangers get what all people share. Mirrored people count
as other people. Simulated people teach as well and share an effect of their own, since
their sensor is not quite a Kinect.

Where nothing like a posture was learned, correction fades to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtri

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget.body_size import chain_matrix

from .interface import CORRECTED_CONFIDENCE, Correction, Observation
from .learned import LearnedCorrector, TrainingSet

Floats = NDArray[np.float32]

# Chosen by leaving one of six people out, and one of their movements.
_LINEAR = 0.4  # variance of the linear part, against 1 of the Gaussian one
_SHARE = 0.1  # a: variance of an effect, against 1 of what all people share
_SIMULATED_SHARE = 0.05  # of the effect that simulated people have in common
_WEIGHT, _SIMULATED_WEIGHT = 6900.0, 150.0  # frames without noise that a person is like
_LEAST_NOISE = 0.1  # variance of the noise in a frame, against a signal of 1
_APART = 8.0 / 30.0  # s between a frame and those that say how it moves
_MOVEMENT, _LENGTHS = 0.5, 2.0  # weights of movement and of segment lengths
_MOST, _SIMULATED_MOST = 2500, 50  # frames of a person that are learned from
_BONE_SHARE = 0.3  # of a person's odd proportions that the sensor makes up
_CENTERS = 1000  # of the postures that were learned from
_ALONE = 3  # so few frames' center would be nearly a recorded posture
_KNOWN, _STRANGE = 0.9, 0.6  # likeness at which most, and nothing, that moves is taken
_MOST_TAKEN = 0.7  # of what moves, for the sake of movements not learned from
_NEAR, _FAR = 0.8, 0.4  # likeness at which all, and nothing, of the constant is taken
_CALM = 3.0  # s over which likeness is averaged
_CONSTANT = 10.0  # s over which live motion's constant correction is averaged

_LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")
_CHUNK = 2048  # frames at a time: features are many times the positions


@dataclass(frozen=True, eq=False)
class _Person:
    """Frames of one person, or of their mirror image."""

    features: Floats
    offsets: Array
    clips: NDArray[np.intp]
    noise: float


class FourierRidge(LearnedCorrector):
    """Adds to each joint the offset to mocap that posture and movement tell.

    Skeletons of all sensors have the joints that it knows; others go along with the
    limb that they are on.

    Args:
        skeleton: The joints.
        samples: Random features of whole takes; live motion has half of them.
        seed: Draws their frequencies.
    """

    fitted = ("weights", "live_weights", "mean", "offset", "bones", "centers", "seed")
    weights_: Floats
    live_weights_: Floats
    mean_: Floats
    offset_: Floats
    bones_: Floats
    centers_: Floats

    def __init__(
        self, skeleton: Skeleton, *, samples: int = 4096, seed: int = 0
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed)
        trunk = [skeleton.root, skeleton.parents[skeleton.girdle], skeleton.girdle]
        sides = [part + side for part in _LIMBS for side in ("Left", "Right")]
        known = [skeleton.index(joint) for joint in ("Head", *sides)]
        self.joints_ = np.array([*trunk, *known])
        rows = {int(j): k for k, j in enumerate(self.joints_)}
        self._mirror = np.array([rows[int(skeleton.mirror[j])] for j in self.joints_])
        self._limbs = self.joints_[len(trunk) + 1 :]
        # The segments between the joints that are known, over those that are not.
        above = [skeleton.parents[j] for j in self.joints_[1:]]
        above = [j if j in rows else skeleton.parents[j] for j in above]
        self._ends = np.arange(1, len(self.joints_))
        self._starts = np.array([rows[j] for j in above])
        body = standard_body(skeleton)
        self._standard = body.lengths[self._limbs]
        rest = body.rest_positions[self.joints_]
        self._segments = np.linalg.norm(rest[self._ends] - rest[self._starts], axis=1)
        # Whose offset each joint takes: its own, or that of the limb it hangs on.
        follows = dict(rows)
        for j in skeleton.order:
            follows.setdefault(j, follows.get(skeleton.parents[j], 0))
        self._follows = np.array([follows[j] for j in range(len(skeleton))])
        self._parents = np.array(skeleton.parents)
        self._hangs = (self._parents >= 0)[:, None]
        self._chain = chain_matrix(skeleton)
        self._hips = [rows[int(j)] for j in skeleton.hips]
        # What features of live motion lack: the difference to what comes after.
        size, segments = 3 * len(self.joints_), len(self._ends)
        kept = np.ones(3 * size + segments + 2, dtype=bool)
        kept[2 * size : 3 * size] = False
        self._live = np.flatnonzero(kept)
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past: list[tuple[float, Array]] = []
        self._constant: Array | None = None
        self._likeness = 0.0

    # Learning

    def fit(
        self,
        training: TrainingSet,
        *,
        simulated: TrainingSet | None = None,
        progress: Progress = silent,
    ) -> Self:
        """Learn offsets from pairs, and from pairs of simulated people beside them."""
        recorded = list(self._people(training, _WEIGHT, _MOST))
        if sum(len(person.features) for person in recorded) < 200:
            raise InputError(
                f"{training.source}: {len(training)} frames are too few to learn from; "
                "give 100 or more"
            )
        others = []
        if simulated is not None:
            people = self._people(simulated, _SIMULATED_WEIGHT, _SIMULATED_MOST)
            others = list(people)
        means = [person.features.mean(axis=0) for person in recorded]
        self.mean_ = np.mean(means, axis=0).astype(np.float16).astype(np.float32)
        means = [person.offsets.mean(axis=0) for person in recorded]
        self.offset_ = np.mean(means, axis=0).astype(np.float32)
        self.bones_ = self._odd_bones(training).astype(np.float32)
        self.seed_ = np.array(self.seed)
        features = np.concatenate([p.features for p in (*recorded, *others)])
        self.centers_ = _rounded(_centers(features, _CENTERS))
        parts: list[NDArray[np.intp]] = [np.arange(features.shape[1]), self._live]
        # Frames are alike: half as many features as frames are plenty.
        most = min(self.samples, len(features) // 4 * 2)
        counts = (most, most // 4 * 2)
        found = []
        steps = iter(progress("learn", 2 * (len(recorded) + len(others))))
        for columns, count in zip(parts, counts, strict=True):
            random = _Features(self.mean_[columns], count, self.seed)
            found.append(self._weights(random, columns, recorded, others, steps))
        for _ in steps:
            pass
        self.weights_, self.live_weights_ = (_rounded(weights) for weights in found)
        self._prepare()
        return self

    def _people(
        self, training: TrainingSet, weight: float, most: int
    ) -> Iterator[_Person]:
        """Yield everybody who was recorded, and their mirror images."""
        if training.skeleton != self.skeleton or training.person is None:
            raise InputError(
                f"{training.source}: pairs of {training.skeleton.name}, but the model "
                f"is for {self.skeleton.name}"
            )
        clip = np.cumsum(training.first) - 1
        for person in np.unique(training.person):
            rows = np.flatnonzero(training.person == person)
            bounds = np.flatnonzero(np.diff(clip[rows], prepend=-1, append=-1))
            takes = [rows[a:b] for a, b in pairwise(bounds)]
            step = -(-len(rows) // most)
            for mirrored in (False, True):
                features, offsets = [], []
                for k, take in enumerate(takes):
                    seen, wanted = self._lesson(training, take, mirrored)
                    # Where a clip begins to be counted varies; a copy frees the rest.
                    features.append(seen[k % step :: step].copy())
                    offsets.append(wanted[k % step :: step].copy())
                sizes = [len(some) for some in features]
                yield _Person(
                    np.concatenate(features),
                    np.concatenate(offsets),
                    np.repeat(np.arange(len(sizes)), sizes),
                    max(_LEAST_NOISE, sum(sizes) / weight),
                )

    def _lesson(
        self, training: TrainingSet, rows: NDArray[np.intp], mirrored: bool
    ) -> tuple[Floats, Array]:
        """Return features and offsets of a take."""
        self._hold.start()
        posture = self._hold.fill(training.positions[rows])
        wanted = (training.truth[rows] - posture)[:, self.joints_]
        # The tracker's joints that mocap lost for a while: the clip's mean.
        known = ~np.isnan(wanted)
        mean = np.where(known, wanted, 0.0).sum(axis=0) / np.maximum(known.sum(0), 1)
        wanted = np.where(known, wanted, mean)
        sensor = None if training.sensor is None else training.sensor[rows]
        toward = _toward(sensor, len(rows))
        points = self._points(posture)
        if mirrored:
            flip = np.array([-1.0, 1.0, 1.0])
            points, wanted = (x[:, self._mirror] * flip for x in (points, wanted))
            toward = toward * flip[:2]
        time = np.arange(len(rows)) / 30.0
        if training.time is not None:
            time = training.time[rows]
        return self._features(points, points, time, time, toward), wanted.reshape(
            len(rows), -1
        )

    def _odd_bones(self, training: TrainingSet) -> Array:
        """Return the mean over people of what ``_proportions`` says."""
        if training.lengths is None or training.person is None:
            return np.zeros(len(self._limbs))
        people = [training.person == p for p in np.unique(training.person)]
        each = [self._proportions(np.median(training.lengths[p], 0)) for p in people]
        return np.asarray(np.mean(each, axis=0))

    def _weights(
        self,
        random: _Features,
        columns: NDArray[np.intp],
        recorded: list[_Person],
        simulated: list[_Person],
        steps: Iterator[int],
    ) -> Array:
        """Return the ridge's weights, all random effects marginalized."""
        size = random.size + 1
        information = np.zeros((size, size), dtype=np.float32, order="F")
        wanted = np.zeros((size, len(self.offset_)))
        self._add(information, wanted, random, columns, simulated, steps)
        if simulated:
            # The effect that all of them share: (I + aG)^-1 G = (I - (I + aG)^-1) / a.
            total = _symmetric(information).astype(float) * _SIMULATED_SHARE
            total[np.diag_indices(size)] += 1.0
            factor = cho_factor(total, overwrite_a=True)
            wanted = cho_solve(factor, wanted)
            left = cho_solve(factor, np.eye(size), overwrite_b=True)
            left[np.diag_indices(size)] -= 1.0
            information = np.asfortranarray(left / -_SIMULATED_SHARE, dtype=np.float32)
        self._add(information, wanted, random, columns, recorded, steps)
        total = _symmetric(information).astype(float)[:-1, :-1]
        total[np.diag_indices(size - 1)] += 1.0
        return np.asarray(cho_solve(cho_factor(total, overwrite_a=True), wanted[:-1]))

    def _add(
        self,
        information: Floats,
        wanted: Array,
        random: _Features,
        columns: NDArray[np.intp],
        people: list[_Person],
        steps: Iterator[int],
    ) -> None:
        """Add what people tell about the weights, and about a constant, in place."""
        waiting: list[Floats] = []
        for person in people:
            next(steps)
            rows, offsets = self._independent(random, columns, person)
            wanted += rows.T @ offsets
            waiting.append(rows)
            if person is people[-1] or sum(map(len, waiting)) > _CHUNK:
                rows, waiting = np.concatenate(waiting), []
                blas.ssyrk(1.0, rows.T, beta=1.0, c=information, overwrite_c=1)

    def _independent(
        self, random: _Features, columns: NDArray[np.intp], person: _Person
    ) -> tuple[Floats, Floats]:
        """Return a person's features and offsets, without what correlates frames."""
        rows = np.ones((len(person.features), random.size + 1), dtype=np.float32)
        rows[:, :-1] = random(person.features[:, columns])
        same = (person.clips[:, None] == person.clips).astype(float)
        covariance = _SHARE * ((rows @ rows.T).astype(float) + same)
        covariance[np.diag_indices(len(rows))] += person.noise
        factor = cholesky(covariance, lower=True, overwrite_a=True).astype(np.float32)
        offsets = (person.offsets - self.offset_).astype(np.float32)
        independent = solve_triangular(
            factor, np.hstack([rows, offsets]), lower=True, overwrite_b=True
        ).astype(np.float32, copy=False)
        return independent[:, : random.size + 1], independent[:, random.size + 1 :]

    # Correcting

    def _prepare(self) -> None:
        seed, size = int(self.seed_), len(self.mean_)
        self._whole = _Features(self.mean_, len(self.weights_) - size, seed)
        mean = self.mean_[self._live]
        self._live_centers = np.ascontiguousarray(self.centers_[:, self._live])
        self._step = _Features(mean, len(self.live_weights_) - len(mean), seed)

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Correct a whole take."""
        self.start()
        posture = self._hold.fill(take.positions)
        points = self._points(posture)
        count = len(points)
        found = np.empty((count, len(self.offset_)))
        likeness = np.empty(count)
        toward = _toward(take.sensor, count)
        for k in range(0, count, _CHUNK):
            some = slice(k, k + _CHUNK)
            features = self._features(
                points[some], points, take.time[some], take.time, toward[some]
            )
            found[some] = self._whole(features) @ self.weights_ + self.offset_
            likeness[some] = _likeness(features, self.centers_)
        step = np.median(np.diff(take.time)) if count > 1 else 1.0
        likeness = gaussian_filter1d(likeness, _CALM / step, mode="nearest")
        constant = found.mean(axis=0)
        return self._moved(take, posture, constant, found - constant, likeness)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        posture = self._hold.step(observation).positions
        points, now = self._points(posture), float(observation.time)
        past = [(time, x) for time, x in self._past if now - time < 2 * _APART]
        self._past = past = [*past, (now, points)]
        times, before = np.array([t for t, _ in past]), np.array([x for _, x in past])
        toward = _toward(observation.sensor, 1)
        time = np.array([now])
        features = self._features(points[None], before, time, times, toward, live=True)
        found = (self._step(features) @ self.live_weights_ + self.offset_)[0]
        likeness = float(_likeness(features, self._live_centers)[0])
        if self._constant is None:
            self._constant, self._likeness = found, likeness
        else:
            elapsed = now - past[-2][0]
            self._constant += min(1.0, elapsed / _CONSTANT) * (found - self._constant)
            change = min(1.0, elapsed / _CALM)
            self._likeness += change * (likeness - self._likeness)
        return self._moved(
            observation,
            posture,
            self._constant,
            found - self._constant,
            np.array(self._likeness),
        )

    def _moved(
        self,
        seen: Observation,
        posture: Array,
        constant: Array,
        moving: Array,
        likeness: Array,
    ) -> Correction:
        """Return the postures, moved as far as their like was learned from."""
        alike = np.clip((likeness - _FAR) / (_NEAR - _FAR), 0.0, 1.0)[..., None]
        share = np.clip((likeness - _STRANGE) / (_KNOWN - _STRANGE), 0.0, 1.0)
        offsets = alike * (constant + _MOST_TAKEN * share[..., None] * moving)
        offsets = offsets.reshape(*offsets.shape[:-1], -1, 3)
        missing = np.isnan(seen.positions[..., 0])
        shift = offsets[..., self._follows, :]
        for j in self.skeleton.order[1:] if missing.any() else ():
            parent, lost = self.skeleton.parents[j], missing[..., j, None]
            hung = shift[..., parent, :]
            shift[..., j, :] = np.where(lost, hung, shift[..., j, :])
        moved = posture + shift
        if seen.lengths is not None:
            odd = self._proportions(seen.lengths) - self.bones_
            bones = moved - moved[..., self._parents, :] * self._hangs
            bones[..., self._limbs, :] *= np.exp(-_BONE_SHARE * alike * odd)[..., None]
            moved = self._chain @ bones
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(moved, None, confidence, likeness)

    def _points(self, postures: Array) -> Array:
        """Return the known joints relative to the hips' middle [m], (..., M, 3)."""
        points = postures[..., self.joints_, :]
        return np.asarray(points - points[..., self._hips, :].mean(-2, keepdims=True))

    def _proportions(self, lengths: Array) -> Array:
        """Return the logarithms of a person's limbs over standard, less their mean."""
        odd = np.log(lengths[self._limbs] / self._standard)
        return np.asarray(odd - odd.mean())

    def _features(
        self,
        points: Array,
        around: Array,
        time: Array,
        times: Array,
        toward: Array,
        *,
        live: bool = False,
    ) -> Floats:
        """Return what the kernel sees of frames, shape (T, F).

        Args:
            points: Known joints of the frames [m], shape (T, M, 3).
            around: Those of all frames there are [m], shape (N, M, 3).
            time: Time stamps of the frames [s], shape (T,).
            times: Those of all frames [s], shape (N,).
            toward: Direction to the sensor, shape (T, 2).
            live: Leave out what comes after.
        """
        parts = [points, _MOVEMENT * (points - _at(times, around, time - _APART))]
        if not live:
            parts.append(_MOVEMENT * (_at(times, around, time + _APART) - points))
        bones = points[:, self._ends] - points[:, self._starts]
        parts.append(_LENGTHS * (np.sqrt(np.vecdot(bones, bones)) - self._segments))
        rows = [part.reshape(len(points), -1) for part in (*parts, toward)]
        return np.concatenate(rows, axis=1, dtype=np.float32)


class _Features:
    """Random features whose products are the kernel of postures' features.

    Args:
        mean: Mean of what they are made of, shape (F,).
        count: How many there are beside the linear ones, an even number.
        seed: Draws their frequencies.
    """

    def __init__(self, mean: Floats, count: int, seed: int) -> None:
        self._mean, size = mean, len(mean)
        blocks = -(-count // (2 * size))
        # Raw bits and the normal quantile: the same in every version of numpy.
        bits = np.random.PCG64(seed).random_raw(blocks * size * size) >> np.uint64(11)
        normal = ndtri((bits.astype(float) + 0.5) * 2.0**-53)
        square = normal.reshape(blocks, size, size)
        turns = np.linalg.qr(square)[0]
        lengths = np.linalg.norm(square, axis=2, keepdims=True)
        rows = (turns * lengths).reshape(-1, size)[: count // 2]
        self._frequencies = rows.T.astype(np.float32)
        self.size = count + size

    def __call__(self, features: Floats) -> Floats:
        """Return the random and the linear features of frames, (T, size)."""
        half = self._frequencies.shape[1]
        made = np.empty((len(features), self.size), dtype=np.float32)
        angles = features @ self._frequencies
        np.cos(angles, out=made[:, :half])
        np.sin(angles, out=made[:, half : 2 * half])
        made[:, : 2 * half] *= np.float32(1.0 / np.sqrt(half))
        made[:, 2 * half :] = (features - self._mean) * np.float32(np.sqrt(_LINEAR))
        return made


def _at(times: Array, values: Array, wanted: Array) -> Array:
    """Return values (N, ...) at other times, between frames; the ends beyond them."""
    if len(times) < 2:
        return np.broadcast_to(values, (len(wanted), *values.shape[1:]))
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    apart = np.maximum(times[after] - times[after - 1], 1e-9)
    share = np.clip((wanted - times[after - 1]) / apart, 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[after - 1] * (1.0 - share) + values[after] * share)


def _toward(sensor: Array | None, count: int) -> Array:
    """Return unit vectors (T, 2), to the left and ahead, from people to the sensor.

    A sensor whose place nobody knows, or that is said to be inside of the person, is
    ahead.
    """
    if sensor is None:
        return np.tile([0.0, 1.0], (count, 1))
    flat = np.atleast_2d(sensor)[:, [0, 2]]
    distance = np.hypot(flat[:, 0], flat[:, 1])[:, None]
    return np.where(distance > 0.5, flat / np.maximum(distance, 0.5), [0.0, 1.0])


def _likeness(features: Floats, centers: Floats) -> Array:
    """Return how like the nearest center frames are, in [0, 1], shape (T,)."""
    squares = np.sum(centers**2, axis=1) - 2.0 * features @ centers.T
    nearest = squares.min(axis=1) + np.sum(features**2, axis=1)
    return np.asarray(np.exp(-0.5 * np.maximum(nearest, 0.0)))


def _centers(features: Floats, count: int) -> Floats:
    """Return centers of the frames; those of a few frames alone are left out."""
    from sklearn.cluster import KMeans

    some = features[np.random.default_rng(0).permutation(len(features))[: 20 * count]]
    count = -(-len(some) // 20)
    means = KMeans(count, init="random", max_iter=10, random_state=0)
    nearest = means.fit_predict(some)
    common = np.bincount(nearest, minlength=count) > _ALONE
    return np.asarray(means.cluster_centers_[common])


def _symmetric(upper: Floats) -> Floats:
    return np.asarray(upper + np.triu(upper, 1).T)


def _rounded(values: NDArray[Any]) -> Floats:
    """Return values as a file of half precision has them."""
    return values.astype(np.float16).astype(np.float32)
