"""The learned corrector: a Gaussian process over posture and movement, as weights.

The kernel k(x, x') = exp(-|x - x'|^2 / 2) + 0.8 x.x' is a product of features:
Fourier's at random, orthogonal frequencies (Yu et al. 2016, Orthogonal random features,
NeurIPS) and the linear ones. So a model is a matrix of weights, and nobody's recording.
Each arm, each leg and the trunk has a kernel of its own, in which the rest of the body
counts little: what was learned of a limb then holds in movements where the others do
something else. Right limbs are corrected as mirror images of left ones.
What is constant in a person or a clip, and what one person alone has with a posture,
are random effects in the training covariance, k (1 + a p) + a p + a c with p and c one
for the same person and clip: strangers get what all people share. Mirrored people count
as other people. Simulated people teach as well and share an effect of their own, since
their sensor is not quite a Kinect.

Limbs on the far side of the body are corrected to what a second sensor, in front, saw
of people whom the first one saw from the side. A person whom the model learned from
gets what that person alone has as well, if it is said who it is.

Where nothing like a posture was learned, correction fades to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags, Indices, Singles, chunks
from kinefilter.retarget.body_size import chain_matrix
from kinefilter.retarget.hands import Hands

from .interface import CORRECTED_CONFIDENCE, Correction, Observation
from .learned import LearnedCorrector
from .posture_features import REACH, PostureFeatures
from .random_features import RandomFeatures, direction_to, likeness_to

# Chosen by leaving one of six people out, and one of their movements.
_BONE_SHARE = 0.3  # of a person's odd proportions that the sensor makes up
# Likeness of a part at which nothing, and all, of what moves its joints is taken: of
# knees, ankles and feet, and of all others.
_STRANGE_LEG, _KNOWN_LEG = 0.85, 1.0
_STRANGE, _KNOWN = 0.7, 0.85
_WRISTS_TAKEN = 0.8  # of what moves them, for the sake of movements not learned from
# Likeness of the whole posture at which nothing, and all, counts.
_FAR, _NEAR = 0.4, 0.8
# Seconds over which likeness is averaged: for what moves, the far side, the constant.
_LATELY, _CALM, _CONSTANT = 0.5, 3.0, 10.0
# Sine of the view angle up to which a view is frontal, and from which on it is fully
# off-frontal. Chosen on all fourteen people with two sensors.
_FRONTAL, _OFF_FRONTAL = 0.2, 0.6
_TURN = 1.0  # s over which the view angle is averaged

_CHUNK = 2048  # frames at a time: features are many times the positions


class FourierRidge(LearnedCorrector):
    """Adds to each joint the offset to mocap that posture and movement tell.

    Skeletons of all sensors have the joints that it knows; others go along with the
    limb that they are on.

    ``lab.methods.fourier_ridge_learner`` teaches it.

    Args:
        skeleton: The joints.
    """

    fitted = (
        *("weights", "live_weights", "mean", "offset", "bones", "centers", "seed"),
        *("arm_centers", "leg_centers", "trunk_centers"),
        *("far_weights", "live_far_weights", "far_centers"),
        *("people", "own_weights", "live_own_weights"),
    )
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
    people_: NDArray[np.str_]
    own_weights_: Singles
    live_own_weights_: Singles

    def __init__(self, skeleton: Skeleton) -> None:
        super().__init__(skeleton)
        self._described = PostureFeatures(skeleton)
        self.joints_ = self._described.joints
        self._parents = np.array(skeleton.parents)
        self._hangs = (self._parents >= 0)[:, None]
        self._chain, self._hands = chain_matrix(skeleton), Hands(skeleton)
        self._body = standard_body(skeleton)
        self._person: int | None = None
        names = [skeleton.joints[j] for j in self.joints_]
        leg = np.array([name.startswith(("Knee", "Ankle", "Foot")) for name in names])
        self._strange = np.where(leg, _STRANGE_LEG, _STRANGE)
        self._known = np.where(leg, _KNOWN_LEG, _KNOWN)
        self._wrists = np.array([name.startswith("Wrist") for name in names])
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past: list[tuple[float, Array]] = []
        self._means: tuple[Any, ...] = ()

    def _prepare(self) -> None:
        described = self._described
        self._features = list[list[RandomFeatures]]()
        self._centers = list[list[tuple[Flags, Singles, Singles]]]()
        everything = np.ones(len(self.mean_), dtype=bool)
        alike = [
            (everything, self.centers_),
            (everything, self.far_centers_),
            *zip(
                (part.own for part in described.parts),
                (self.arm_centers_, self.leg_centers_, self.trunk_centers_),
                strict=True,
            ),
        ]
        for weights, some in (
            (self.weights_, np.arange(len(everything))),
            (self.live_weights_, described.live),
        ):
            mean, seed = self.mean_[some], int(self.seed_)
            count = len(weights) - len(mean)
            self._features.append(
                [
                    RandomFeatures(mean, count, seed, part.weights[some])
                    for part in described.parts
                ]
            )
            self._centers.append([])
            for own, centers in alike:
                kept = np.isin(np.flatnonzero(own), some)
                near = np.ascontiguousarray(centers[:, kept])
                self._centers[-1].append((own[some], near, np.sum(near**2, axis=1)))
        self.know(None)

    def know(self, person: str | None) -> None:
        """Correct this person, if the model learned from them, or else a stranger."""
        known = self.people_.tolist()
        self._person = known.index(person) if person in known else None
        self._offsets: list[list[tuple[Singles, Array]]] = []
        for shared, far, own in (
            (self.weights_, self.far_weights_, self.own_weights_),
            (self.live_weights_, self.live_far_weights_, self.live_own_weights_),
        ):
            beside = far if len(far) else np.zeros_like(shared)
            sides = []
            for side in range(2):
                here, constant = shared, self.offset_
                if self._person is not None:
                    here = shared + own[self._person, side, :-1]
                    constant = constant + own[self._person, side, -1]
                constants = np.stack([constant, np.zeros_like(constant)])
                sides.append((np.stack([here, beside]), constants))
            self._offsets.append(sides)

    def _told(self, features: Singles, *, live: bool) -> tuple[Array, Array, Array]:
        """Return offsets of frames, those of the far side, and their likenesses.

        Those are of the whole posture to people with markers and to those beside a
        sensor, shape (T, 2), and of the part of each known joint, shape (T, M).
        """
        described = self._described
        order, signs = described.live_mirror if live else described.mirror
        sides = (features, features[:, order] * signs.astype(np.float32))
        whole, by_part = self._centers[live][:2], self._centers[live][2:]
        found, parts = [], []
        for side, (weights, constants) in zip(sides, self._offsets[live], strict=True):
            told, first = [], 0
            for part, random in zip(described.parts, self._features[live], strict=True):
                last = first + 3 * len(part.joints)
                told.append(random(side) @ weights[..., first:last])
                first = last
            offsets = np.concatenate(told, axis=2) + constants[:, None]
            found.append(offsets.reshape(2, len(side), -1, 3))
            parts.append(
                [likeness_to(side[:, own], near, size) for own, near, size in by_part]
            )
        likeness = [likeness_to(features, near, size) for _, near, size in whole]
        alike = np.array(parts)[described.mirrored_side.astype(int), described.part_of]
        return described.joined(*found), np.stack(likeness, axis=1), alike.T

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Correct a whole take."""
        self.start()
        posture = self._hold.fill(take.positions)
        points = self._described.points(posture)
        count = len(points)
        found = np.empty((2, *points.shape))
        likeness, alike = np.empty((count, 2)), np.empty(points.shape[:2])
        toward = direction_to(take.sensor, count)
        for some in chunks(count, _CHUNK):
            features = self._described(
                points[some], points, take.time[some], take.time, toward[some]
            )
            found[:, some], likeness[some], alike[some] = self._told(
                features, live=False
            )
        step = np.median(np.diff(take.time)) if count > 1 else 1.0
        window = int(max(_TURN / step, 1.0))
        toward = uniform_filter1d(toward, window, axis=0, mode="nearest")
        near, lately, lasting = (
            gaussian_filter1d(values, over / step, axis=0, mode="nearest")
            for values, over in (
                (alike, _LATELY),
                (likeness, _CALM),
                (_share_of_constant(likeness, toward), _CONSTANT),
            )
        )
        here, far = found
        constant = np.broadcast_to(here.mean(axis=0), here.shape)
        offsets = _Offsets(
            constant, here - constant, far, near, lately, lasting, toward
        )
        return self._moved(take, posture, offsets)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        posture = self._hold.step(observation).positions
        points, now = self._described.points(posture), float(observation.time)
        elapsed = now - self._past[-1][0] if self._past else 0.0
        past = [(time, x) for time, x in self._past if now - time < REACH]
        self._past = past = [*past, (now, points)]
        times, before = np.array([t for t, _ in past]), np.array([x for _, x in past])
        toward = direction_to(observation.sensor, 1)
        features = self._described(
            points[None], before, np.array([now]), times, toward, live=True
        )
        ((found,), (far,)), (likeness,), (alike,) = self._told(features, live=True)
        spans = (_CONSTANT, _LATELY, _CALM, _CONSTANT, _TURN / 2.0)
        lasting = _share_of_constant(likeness, toward[0])
        latest = (found, alike, likeness, lasting, toward[0])
        self._means = tuple(
            mean + min(1.0, elapsed / span) * (value - mean)
            for mean, value, span in zip(
                self._means or latest, latest, spans, strict=True
            )
        )
        constant, *lately = self._means
        offsets = _Offsets(constant, found - constant, far, *lately)
        return self._moved(observation, posture, offsets)

    def _moved(self, seen: Observation, posture: Array, found: _Offsets) -> Correction:
        """Return the postures, moved as far as their like was learned from."""
        side = found.toward[..., :1] * self._described.sides
        off_frontal = _off_frontal_share(side, found.lately)
        beside = np.where(side < 0.0, off_frontal, 0.0)
        share = _ramp(found.alike, self._strange, self._known)
        if self._person is None:
            share = np.where(self._wrists, _WRISTS_TAKEN * share, share)
        offsets = found.lasting[..., None] * found.constant
        offsets = offsets + (share * (1.0 - off_frontal))[..., None] * found.moving
        offsets = offsets + beside[..., None] * found.far
        missing = np.isnan(seen.positions[..., 0])
        shift = offsets[..., self._described.follows, :]
        for j in self.skeleton.order[1:] if missing.any() else ():
            parent, lost = self.skeleton.parents[j], missing[..., j, None]
            hung = shift[..., parent, :]
            shift[..., j, :] = np.where(lost, hung, shift[..., j, :])
        moved = posture + shift
        if beside.any():
            # A hand behind the body is the sensor's guess as well.
            hidden = beside[..., self._described.follows]
            moved = self._hands.straightened(moved, hidden, self._body)
        if seen.lengths is not None and self._person is None:
            odd = self._described.proportions(seen.lengths) - self.bones_
            scale = np.exp(-_BONE_SHARE * found.lasting * odd)[..., None]
            bones = moved - moved[..., self._parents, :] * self._hangs
            bones[..., self._described.limbs, :] *= scale
            moved = self._chain @ bones
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(moved, None, confidence, found.lately[..., 0])


class _Offsets(NamedTuple):
    """What the model says of frames, and how much it knows about them."""

    constant: Array
    """What stays, of all known joints [m], shape (..., M, 3)."""
    moving: Array
    """What moves, likewise."""
    far: Array
    """What limbs on the far side are off, likewise."""
    alike: Array
    """Likeness of the joint's part to what was learned from, just now, (..., M)."""
    lately: Array
    """Likeness to people with markers, and to those beside a sensor, over seconds."""
    lasting: Array
    """Share of the constant that is taken, over a longer time, shape (..., 1)."""
    toward: Array
    """Direction to the sensor, shape (..., 2)."""


def _share_of_constant(likeness: Array, toward: Array) -> Array:
    """Return the share of the constant offset, by likeness (..., 2).

    The sensor misplaces the joints of who is seen from the side in another way.
    """
    off_frontal = _off_frontal_share(toward[..., :1], likeness)
    return _ramp(likeness[..., :1], _FAR, _NEAR) * (1.0 - off_frontal)


def _off_frontal_share(sine: Array, likeness: Array) -> Array:
    """Return how far a view counts as off-frontal, 0 to 1.

    Args:
        sine: Of the view angle, 0 where the person faces the sensor.
        likeness: As ``_Offsets.lately``: no view counts that nothing was learned from.
    """
    off_frontal = _ramp(np.abs(sine), _FRONTAL, _OFF_FRONTAL)
    return off_frontal * _ramp(likeness[..., 1:], _FAR, _NEAR)


def _ramp(values: Array, none: Array | float, whole: Array | float) -> Array:
    return np.asarray(np.clip((values - none) / (whole - none), 0.0, 1.0))
