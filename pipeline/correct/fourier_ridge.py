"""The learned corrector: a Gaussian process over posture and movement, as weights.

The kernel k(x, x') = exp(-|x - x'|^2 / 2) + 0.8 x.x' is an inner product of features:
Fourier features at random orthogonal frequencies (Yu et al. 2016, Orthogonal random
features, NeurIPS) and linear ones. A model is therefore a matrix of weights, without
any recording. Arms, legs and trunk have a kernel each, in which the rest of the body
has little weight, so that training carries over to movements in which the rest of the
body does something else. Right limbs are corrected as mirror images of left ones.

The constant offset of a person or a clip, and how a person's own offset depends on the
posture, are random effects in the training covariance, k (1 + a p) + a p + a c with p
and c equal to 1 for the same person and clip: strangers get what all people share.
Mirrored people count as other people. Simulated people are training data, too, and
share an effect of their own, because their sensor is not quite a Kinect.

Limbs on the far side of the body, shoulders and hips are corrected toward what a second
sensor, in front, saw of people whom the first one saw from the side. Kinect v2 shows
trunks turned toward itself; they are turned away again, and with them the foot behind
the body. People from the training data who are named get their own effects as well.
Away from the training data, the correction fades to zero.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from kinefilter.characters import KINECT_V2, Skeleton, standard_body
from kinefilter.characters.arrays import Array, Indices, Singles, chunks
from kinefilter.characters.rotations import between, rotate, unit
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.standardize import chain_matrix
from kinefilter.retarget.straight_chains import softened

from .interface import CORRECTED_CONFIDENCE, Correction, Frames, Observation
from .learned import LearnedCorrector
from .posture_features import (
    REACH,
    PostureFeatures,
    RandomFeatures,
    direction_to,
    part_of_turn,
    similarity_to,
)

# Chosen by leaving one of six people out, and one of their movements.
_BONE_SHARE = 0.3  # of a person's unusual proportions that is due to the sensor
# Similarity of a part at which none, and all, of the moving offset is applied: for
# knees, ankles and feet, and for all other joints.
_STRANGE_LEG, _FAMILIAR_LEG = 0.85, 1.0
_STRANGE, _FAMILIAR = 0.7, 0.85
_WRIST_SHARE = 0.8  # of the wrists' moving offset, for movements not in the training
# Longest moving offsets [m] that are applied in full, in movements unlike the training
# and in ones like it; longer ones never reach twice that. RESULTS says how chosen.
_ROOM = (0.02, 0.12)
# Similarity of the whole posture at which none, and all, of the offsets is applied.
_FAR, _NEAR = 0.4, 0.8
# Seconds over which similarity is averaged: that of a part, that of the posture, and
# the share of the constant offset that follows from it.
_FAST, _MEDIUM, _SLOW = 0.5, 3.0, 10.0
# Power of the mean of that share: familiar frames tell it, strange ones do not. Chosen
# on s02 and s07, and on walks of CMU.
_POWER = 16
# Sine of the view angle up to which a view is frontal, and from which on it is fully
# off-frontal. Chosen on all fourteen people with two sensors.
_FRONTAL, _OFF_FRONTAL = 0.2, 0.6
# People with markers may stand turned, too. The data that a posture is more similar to
# decides; where the similarities differ by less than this, both count. Chosen on s02,
# s07 and s08, and on p00 to p08.
_TIED = 0.02
_VIEW_TIME = 1.0  # s over which the view angle is averaged
_CHUNK = 256  # frames at a time: features of more do not fit into caches. Timed.


class FourierRidge(LearnedCorrector):
    """Adds to each joint the offset to mocap, predicted from posture and movement.

    It corrects the joints that the skeletons of all sensors have; the others move with
    the limb that they are on. ``lab.methods.fourier_ridge_learner`` trains it.
    """

    weights_: Singles
    live_weights_: Singles
    mean_: Singles
    offset_: Singles
    bones_: Singles
    centers_: Singles
    seed_: Indices
    arm_centers_: Singles
    leg_centers_: Singles
    trunk_centers_: Singles
    far_weights_: Singles
    live_far_weights_: Singles
    far_centers_: Singles
    turn_share_: Array
    people_: NDArray[np.str_]
    own_weights_: Singles
    live_own_weights_: Singles
    fitted = tuple(name.removesuffix("_") for name in __annotations__)  # all of these

    def __init__(self, skeleton: Skeleton) -> None:
        super().__init__(skeleton)
        self._posture_features = PostureFeatures(skeleton)
        self.joints_ = self._posture_features.joints
        self._parents = np.array(skeleton.parents)
        self._hangs = (self._parents >= 0)[:, None]
        self._chain = chain_matrix(skeleton)
        spine = skeleton.parents[skeleton.girdle]
        self._trunk_chain = [skeleton.root, spine, skeleton.girdle]
        self._standard = standard_body(skeleton).lengths
        self._above = self._chain[:, [skeleton.girdle]]  # 1 from the girdle on
        self._person: int | None = None
        names = [skeleton.joints[j] for j in self.joints_]
        leg = [name.startswith(("Knee", "Ankle", "Foot")) for name in names]
        self._strange = np.where(leg, _STRANGE_LEG, _STRANGE)
        self._familiar = np.where(leg, _FAMILIAR_LEG, _FAMILIAR)
        self._wrists = np.array([name.startswith("Wrist") for name in names])
        chain = ("Hip", "Knee", "Ankle", "Foot")
        legs = [[names.index(part + side) for part in chain] for side in SIDES]
        self._legs = np.array(legs)
        # How Kinect v1 shows trunks from the side has not been measured.
        measured = skeleton == KINECT_V2
        ends, feet = (("Shoulder", "Hip"), ("Foot",)) if measured else ((), ())
        self._pairs = [skeleton.sides(part) for part in ends]
        sides = [zip(skeleton.sides(part), (1.0, -1.0), strict=True) for part in feet]
        self._feet = [([foot], side) for pair in sides for foot, side in pair]
        self._trunk = np.isin(self.joints_, self._pairs)
        self._hidden = self._posture_features.sides != 0.0
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._past: list[tuple[float, Array]] = []
        self._means: tuple[Any, ...] = ()

    def _prepare(self) -> None:
        self._inputs = dict[bool, _Inputs]()
        self.select_person(None)

    def _inputs_of(self, *, live: bool) -> _Inputs:
        """Return the features of live motion or of takes, made when first needed."""
        if live in self._inputs:
            return self._inputs[live]
        described, every = self._posture_features, np.ones(len(self.mean_), dtype=bool)
        columns = described.live if live else np.arange(len(every))
        mean, seed = self.mean_[columns], int(self.seed_)
        count = len(self.live_weights_ if live else self.weights_) - len(mean)
        random = [
            RandomFeatures(mean, count, seed, part.weights[columns])
            for part in described.parts
        ]
        order, signs = described.mirror
        own_order = np.asarray(np.searchsorted(columns, order[columns]))
        mirror = own_order, signs[columns].astype(np.float32)
        of_parts = (self.arm_centers_, self.leg_centers_, self.trunk_centers_)
        found = [(every, self.centers_), (every, self.far_centers_)]
        found += zip((part.own for part in described.parts), of_parts, strict=True)
        centers = list[tuple[Indices, Singles, Singles]]()
        for own, there in found:
            kept = np.isin(np.flatnonzero(own), columns)
            near = np.ascontiguousarray(there[:, kept])
            own_columns = np.flatnonzero(own[columns])
            centers.append((own_columns, near, np.sum(near**2, axis=1)))
        return self._inputs.setdefault(live, _Inputs(random, mirror, centers))

    def select_person(self, person: str | None) -> None:
        """Select a person from the training data by name; others are strangers."""
        known = self.people_.tolist()
        self._person = known.index(person) if person in known else None
        # Weights and constants of left and right limbs, or of both; near and far side.
        self._offsets: list[tuple[Singles, Singles]] = []
        for shared, far, own in (
            (self.weights_, self.far_weights_, self.own_weights_),
            (self.live_weights_, self.live_far_weights_, self.live_own_weights_),
        ):
            near, constant = shared[None], self.offset_[None]
            if self._person is not None:
                near = near + own[self._person, :, :-1]
                constant = constant + own[self._person, :, -1]
            opposite = np.zeros_like(near)
            opposite[:] = far if len(far) else 0.0
            constants = np.stack([constant, np.zeros_like(constant)], axis=1)
            rows = np.ascontiguousarray(np.stack([near, opposite], axis=1).mT)
            self._offsets.append((rows, constants))

    def _predict(self, features: Singles, *, live: bool) -> tuple[Array, Array, Array]:
        """Return offsets [m] (2, T, M, 3), near and far side, and two similarities.

        These are of the whole posture to frontal and to side-on training data, shape
        (T, 2), and of the part of each known joint to its own, shape (T, M).
        """
        described, inputs = self._posture_features, self._inputs_of(live=live)
        order, signs = inputs.mirror
        sides = np.concatenate([features, features[:, order] * signs])
        count = len(features)
        whole, by_part = inputs.centers[:2], inputs.centers[2:]
        weights, constants = self._offsets[live]
        predicted, first = [], 0
        for part, random in zip(described.parts, inputs.random, strict=True):
            last = first + 3 * len(part.joints)
            own = weights[..., first:last, :].mT
            predicted.append(random(sides).reshape(2, 1, count, -1) @ own)
            first = last
        offsets = np.concatenate(predicted, axis=3) + constants[:, :, None]
        parts = [similarity_to(sides[:, own], *centers) for own, *centers in by_part]
        posture = [similarity_to(features, *centers) for _, *centers in whole]
        by_side = np.array(parts).reshape(len(parts), 2, -1)
        joints = by_side[described.part_of, described.is_right.astype(int)]
        merged = described.merge_sides(*offsets.reshape(2, 2, count, -1, 3))
        return merged, np.stack(posture, axis=1), joints.T

    def whole(self, take: Observation, frames: Frames = None) -> Correction:  # noqa: ARG002 - no loop
        """Correct a whole take."""
        self.start()
        posture = self._hold.fill(take.positions)
        points = self._posture_features.points(posture)
        count = len(points)
        offsets = np.empty((2, *points.shape))
        similar, parts = np.empty((count, 2)), np.empty(points.shape[:2])
        toward = direction_to(take.sensor, count)
        for some in chunks(count, _CHUNK):
            times = take.time[some], take.time
            seen = self._posture_features(points[some], points, *times, toward[some])
            predicted = self._predict(seen, live=False)
            offsets[:, some], similar[some], parts[some] = predicted
        step = np.median(np.diff(take.time)) if count > 1 else 1.0
        window = int(max(_VIEW_TIME / step, 1.0))
        toward = uniform_filter1d(toward, window, axis=0, mode="reflect")
        share = _shares(similar, toward)
        parts, similar, share = (
            gaussian_filter1d(values, span / step, axis=0, mode="reflect")
            for values, span in ((parts, _FAST), (similar, _MEDIUM), (share, _SLOW))
        )
        near, far = offsets
        legs = self._leg_directions(points)
        constant = np.broadcast_to(near.mean(axis=0), near.shape)
        constant = self._turned_with_legs(constant, legs.mean(axis=0), legs)
        found = _Offsets(constant, near - constant, far, parts, similar, share, toward)
        return self._apply(take, posture, found)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        posture = self._hold.step(observation).positions
        points, now = self._posture_features.points(posture), float(observation.time)
        if not self._past:
            self._began = now
        elapsed = now - self._past[-1][0] if self._past else 0.0
        past = [(time, x) for time, x in self._past if now - time < REACH]
        self._past = [*past, (now, points)]
        times, around = map(np.array, zip(*self._past, strict=True))
        toward = direction_to(observation.sensor, 1)
        features = self._posture_features(
            points[None], around, np.array([now]), times, toward, live=True
        )
        ((near,), (far,)), (similar,), (parts,) = self._predict(features, live=True)
        share = _shares(similar, toward[0])
        legs = self._leg_directions(points)
        spans = (_SLOW, _SLOW, _FAST, _MEDIUM, _SLOW, _VIEW_TIME / 2.0)
        latest = (near, legs, parts, similar, share, toward[0])
        since = now - self._began + elapsed
        means = zip(self._means or latest, latest, spans, strict=True)
        self._means = tuple(
            mean + elapsed / (max(min(span, since), elapsed) or 1.0) * (value - mean)
            for mean, value, span in means
        )
        constant, usual, *averaged = self._means
        constant = self._turned_with_legs(constant, usual, legs)
        found = _Offsets(constant, near - constant, far, *averaged)
        return self._apply(observation, posture, found)

    def _leg_directions(self, points: Array) -> Array:
        """Return unit vectors along thighs and shins, left and right (..., 2, 2, 3)."""
        return unit(np.diff(points[..., self._legs[:, :3], :], axis=-2))

    def _turned_with_legs(self, constant: Array, usual: Array, legs: Array) -> Array:
        """Return constant offsets (..., M, 3) that turn with thighs and shins.

        ``usual`` and ``legs`` are their directions, on average and now. Offsets that
        make standing legs longer would otherwise lower feet that kick.
        """
        bones = np.diff(constant[..., self._legs, :], axis=-2)
        bones[..., :2, :] = rotate(between(usual, legs), bones[..., :2, :])
        turned, hips = constant.copy(), constant[..., self._legs[:, :1], :]
        turned[..., self._legs[:, 1:], :] = hips + bones.cumsum(axis=-2)
        return turned

    def _apply(self, seen: Observation, posture: Array, found: _Offsets) -> Correction:
        """Return the postures plus the offsets, weighted by similarity."""
        across, trunk = found.toward[..., :1], self._trunk
        of_view = _off_frontal_share(across, found.similar)
        off_frontal = np.where(trunk | self._hidden, of_view, 0.0)
        far_side = trunk | (across * self._posture_features.sides < 0.0)
        share = _ramp(found.parts, self._strange, self._familiar)
        if self._person is None:
            share = np.where(self._wrists, _WRIST_SHARE * share, share)
        familiar, frontal = found.share[..., :1], found.share[..., 1:]
        constancy = familiar ** (1.0 / _POWER) * frontal
        offsets = constancy[..., None] * found.constant
        moving = _limited(found.moving, _ROOM[0] + familiar * (_ROOM[1] - _ROOM[0]))
        offsets = offsets + (share * (1.0 - off_frontal))[..., None] * moving
        offsets = offsets + (far_side * off_frontal)[..., None] * found.far
        missing = np.isnan(seen.positions[..., 0])
        shift = offsets.take(self._posture_features.carrier, -2)
        for j in self.skeleton.order[1:] if missing.any() else ():
            ends = shift[..., self.skeleton.parents[j], :], shift[..., j, :]
            shift[..., j, :] = np.where(missing[..., j, None], *ends)
        if seen.lengths is not None:
            shift += self._trunk_shift(shift, seen.lengths)
        moved = posture + shift
        if seen.lengths is not None and self._person is None:
            odd = self._posture_features.proportions(seen.lengths) - self.bones_
            scale = np.exp(-_BONE_SHARE * constancy * odd)[..., None]
            bones = moved - moved.take(self._parents, -2) * self._hangs
            bones[..., self._posture_features.limbs, :] *= scale
            moved = self._chain @ bones
        turn = part_of_turn(found.toward, float(self.turn_share_))
        turn = _beside_share(found.similar)[..., 0] * turn
        if turn.any():
            for pair in self._pairs:
                middle = moved[..., pair, :].mean(axis=-2)
                moved[..., pair, :] = _turned(moved[..., pair, :], turn, middle)
            for foot, side in self._feet:  # only the one behind the body
                far = np.where(side * found.toward[..., 0] < 0.0, turn, 0.0)
                ankle = moved[..., self._parents[foot[0]], :]
                moved[..., foot, :] = _turned(moved[..., foot, :], far, ankle)
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(moved, confidence, found.similar[..., 0])

    def _trunk_shift(self, shift: Array, lengths: Array) -> Array:
        """Return what to add to offsets (..., J, 3) for a trunk of these proportions.

        The girdle then moves as far on the person's body, for its size, as on the
        standard body. Kinect v1 has the spine joint near the hips; the long bone above
        it would tilt as the short one of the standard body does.
        """
        trunk = self._trunk_chain[1:]
        root, spine, girdle = (shift[..., j, :] for j in self._trunk_chain)
        low, high = lengths[trunk] / self._standard[trunk]
        whole = lengths[trunk].sum() / self._standard[trunk].sum()
        bone = (whole * (girdle - root) - low * (spine - root)) / high
        return np.asarray((bone - girdle + spine)[..., None, :] * self._above)


class _Inputs(NamedTuple):
    """What the features of motions are, and what is known of them."""

    random: list[RandomFeatures]  # of each part
    mirror: tuple[Indices, Singles]  # order and signs of those of the mirror image
    centers: list[tuple[Indices, Singles, Singles]]
    """Columns, data, their squared lengths: of postures frontal, side-on, of parts."""


class _Offsets(NamedTuple):
    """Predicted offsets of frames, and what decides how much of them is applied."""

    constant: Array  # of all known joints [m], shape (..., M, 3)
    moving: Array  # offsets less their constant part, likewise
    far: Array  # offsets of limbs on the far side of the body, likewise
    parts: Array  # similarity of each joint's part to the training data, (..., M)
    similar: Array  # similarity of the posture to frontal and side-on data, (..., 2)
    share: Array  # of the constant part to apply, as ``_shares``, (..., 2)
    toward: Array  # direction to the sensor, shape (..., 2)


def _shares(similar: Array, toward: Array) -> Array:
    """Return how familiar and how frontal frames are: shares of the constant offset."""
    familiar = _ramp(similar[..., :1], _FAR, _NEAR) ** _POWER
    frontal = 1.0 - _off_frontal_share(toward[..., :1], similar)
    return np.concatenate([familiar, frontal], axis=-1)


def _off_frontal_share(sine: Array, similar: Array) -> Array:
    """Return the weight of the two-sensor training data in this view, in [0, 1]."""
    return _ramp(np.abs(sine), _FRONTAL, _OFF_FRONTAL) * _beside_share(similar)


def _beside_share(similar: Array) -> Array:
    """Return the weight (..., 1) of the two-sensor data, given both similarities."""
    frontal, beside = similar[..., :1], similar[..., 1:]
    return _ramp(beside, _FAR, _NEAR) * _ramp(beside - frontal, -_TIED, _TIED)


def _limited(vectors: Array, free: Array) -> Array:
    """Return vectors (..., M, 3), those longer than ``free`` (..., 1) shortened."""
    size = np.maximum(np.linalg.norm(vectors, axis=-1), 1e-9)
    return np.asarray((softened(size, free, 2.0 * free) / size)[..., None] * vectors)


def _turned(positions: Array, turn: Array, center: Array) -> Array:
    """Return positions (..., K, 3) turned about a vertical line through a point."""
    return HeadingFrame(center, turn).restore(positions - center[..., None, :])


def _ramp(values: Array, none: Array | float, whole: Array | float) -> Array:
    return np.asarray(((values - none) / (whole - none)).clip(0.0, 1.0))
