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
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget.body_size import chain_matrix

from .interface import CORRECTED_CONFIDENCE, Correction, Observation
from .learned import LearnedCorrector, TrainingSet
from .random_features import (
    Floats,
    RandomFeatures,
    centers_of,
    direction_to,
    likeness_to,
    rounded,
    values_at,
)
from .ridge import Person, ridge_weights

# Chosen by leaving one of six people out, and one of their movements.
_WEIGHT, _SIMULATED_WEIGHT = 6900.0, 150.0  # frames without noise that a person is like
_LEAST_NOISE = 0.1  # variance of the noise in a frame, against a signal of 1
_APART = 8.0 / 30.0  # s between a frame and those that say how it moves
_MOVEMENT, _LENGTHS = 0.5, 2.0  # weights of movement and of segment lengths
_MOST, _SIMULATED_MOST = 2500, 50  # frames of a person that are learned from
_BONE_SHARE = 0.3  # of a person's odd proportions that the sensor makes up
_CENTERS = 1000  # of the postures that were learned from
_KNOWN, _STRANGE = 0.9, 0.6  # likeness at which most, and nothing, that moves is taken
_MOST_TAKEN = 0.8  # of what moves, for the sake of movements not learned from
_NEAR, _FAR = 0.8, 0.4  # likeness at which all, and nothing, of the constant is taken
_CALM = 3.0  # s over which likeness is averaged
_CONSTANT = 10.0  # s over which live motion's constant correction is averaged

_LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")
_CHUNK = 2048  # frames at a time: features are many times the positions


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
        self.centers_ = rounded(centers_of(features, _CENTERS))
        parts: list[NDArray[np.intp]] = [np.arange(features.shape[1]), self._live]
        # Frames are alike: half as many features as frames are plenty.
        most = min(self.samples, len(features) // 4 * 2)
        counts = (most, most // 4 * 2)
        found = []
        steps = iter(progress("learn", 2 * (len(recorded) + len(others))))
        for columns, count in zip(parts, counts, strict=True):
            random = RandomFeatures(self.mean_[columns], count, self.seed)
            found.append(
                ridge_weights(random, columns, recorded, others, self.offset_, steps)
            )
        for _ in steps:
            pass
        self.weights_, self.live_weights_ = (rounded(weights) for weights in found)
        self._prepare()
        return self

    def _people(
        self, training: TrainingSet, weight: float, most: int
    ) -> Iterator[Person]:
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
                yield Person(
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
        toward = direction_to(sensor, len(rows))
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

    # Correcting

    def _prepare(self) -> None:
        seed, size = int(self.seed_), len(self.mean_)
        self._whole = RandomFeatures(self.mean_, len(self.weights_) - size, seed)
        mean = self.mean_[self._live]
        self._live_centers = np.ascontiguousarray(self.centers_[:, self._live])
        self._step = RandomFeatures(mean, len(self.live_weights_) - len(mean), seed)

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
        toward = direction_to(take.sensor, count)
        for k in range(0, count, _CHUNK):
            some = slice(k, k + _CHUNK)
            features = self._features(
                points[some], points, take.time[some], take.time, toward[some]
            )
            found[some] = self._whole(features) @ self.weights_ + self.offset_
            likeness[some] = likeness_to(features, self.centers_)
        step = np.median(np.diff(take.time)) if count > 1 else 1.0
        likeness = gaussian_filter1d(likeness, _CALM / step, mode="nearest")
        constant = found.mean(axis=0)
        return self._moved(take, posture, constant, found - constant, likeness)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        posture = self._hold.step(observation).positions
        points, now = self._points(posture), float(observation.time)
        elapsed = now - self._past[-1][0] if self._past else 0.0
        past = [(time, x) for time, x in self._past if now - time < 2 * _APART]
        self._past = past = [*past, (now, points)]
        times, before = np.array([t for t, _ in past]), np.array([x for _, x in past])
        toward = direction_to(observation.sensor, 1)
        time = np.array([now])
        features = self._features(points[None], before, time, times, toward, live=True)
        found = (self._step(features) @ self.live_weights_ + self.offset_)[0]
        likeness = float(likeness_to(features, self._live_centers)[0])
        if self._constant is None:
            self._constant, self._likeness = found, likeness
        else:
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
        parts = [points, _MOVEMENT * (points - values_at(times, around, time - _APART))]
        if not live:
            parts.append(_MOVEMENT * (values_at(times, around, time + _APART) - points))
        bones = points[:, self._ends] - points[:, self._starts]
        parts.append(_LENGTHS * (np.sqrt(np.vecdot(bones, bones)) - self._segments))
        rows = [part.reshape(len(points), -1) for part in (*parts, toward)]
        return np.concatenate(rows, axis=1, dtype=np.float32)
