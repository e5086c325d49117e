"""The features of postures and movement that the learned corrector uses."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags, Indices, Singles
from kinefilter.characters.motion import values_at
from kinefilter.characters.skeleton import LIMB_PARTS

_APART = 8.0 / 30.0  # s between a frame and those that describe its movement
_MOVEMENT, _LENGTHS, _TOWARD = 0.5, 2.0, 0.6  # weights, against 1 for positions [m]
_LIMBS = (*LIMB_PARTS, "Foot")
_HIDDEN = ("Elbow", "Wrist", "Knee", "Ankle", "Foot")  # by the body, from the side
# Arm, leg and trunk: the known joints that are corrected (left or in the middle), and
# those that describe the part. Known joints are root, spine, girdle and head, then left
# and right of each of _LIMBS.
_PARTS = (
    ((4, 6, 8), (0, 2, 4, 6, 8)),
    ((10, 12, 14, 16), (0, 2, 10, 11, 12, 14, 16)),
    ((0, 1, 2, 3), (0, 1, 2, 3, 4, 5, 10, 11)),
)
# Weight of features of the rest of the body: the smaller, the more of the training
# carries over to new movements. Chosen by leaving one of six people and a movement out.
_REST = 0.15
_TURNED = 0.2  # rad from the sensor up to which trunks are shown as they are
_LINEAR = 0.8  # variance of the linear part, against 1 for the Gaussian part

REACH = 2.0 * _APART  # s: older frames do not influence the features of movement


class Part(NamedTuple):
    """The left arm, the left leg, or the trunk."""

    joints: Indices  # its joints, as indices into the known joints, shape (K,)
    own: Flags  # True for the features of the part itself, shape (F,)
    weights: Singles  # of all features, shape (F,)


class PostureFeatures:
    """Describes postures by the joints that the skeletons of all sensors have.

    The features are the positions of the M known joints, their movement since some
    frames before and until some frames after, the lengths of M - 1 segments, and the
    direction to the sensor. Other joints move with the limb that they are on.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        spine = [skeleton.root, skeleton.parents[skeleton.girdle], skeleton.girdle]
        trunk = [*spine, skeleton.index("Head")]
        limbs = [j for part in _LIMBS for j in skeleton.sides(part)]
        self.joints = np.array([*trunk, *limbs])  # the known ones, shape (M,)
        self.limbs = self.joints[len(trunk) :]  # those of arms and legs
        rows = {int(j): k for k, j in enumerate(self.joints)}
        known = np.arange(len(rows))
        self._mirror = np.array([rows[j] for j in skeleton.mirror[self.joints]])
        side = [(part in _HIDDEN) * sign for part in _LIMBS for sign in (1, -1)]
        # 1 for left joints that the body can hide, -1 for right ones, 0 for others.
        self.sides = np.array([*np.zeros(len(trunk)), *side])
        # Segments between known joints skip the joint that only some sensors have.
        parents = skeleton.parents
        above = [parents[j] for j in self.joints[1:]]
        self._starts = np.array([rows.get(j, rows.get(parents[j])) for j in above])
        body = standard_body(skeleton)
        self._standard = body.lengths[self.limbs]
        bones = self._bones(body.rest_positions[self.joints])
        self._segments = np.linalg.norm(bones, axis=1)
        carrier = dict(rows)
        for j in skeleton.order:
            carrier.setdefault(j, carrier.get(parents[j], 0))
        # The known joint with which each joint moves: itself, or one of its limb.
        self.carrier = np.array([carrier[j] for j in range(len(skeleton))])
        self._hips = [rows[j] for j in skeleton.hips]
        size = 3 * len(known)
        count = 3 * size + len(known) - 1 + 2
        order, signs = np.arange(count), np.ones(count)
        vectors = order[: 3 * size].reshape(3, -1, 3)
        vectors[:] = vectors[:, self._mirror]
        signs[: 3 * size : 3] = -1.0
        order[3 * size : -2] = 3 * size + self._mirror[1:] - 1
        signs[-2] = -1.0
        self.mirror = (order, signs)  # of the features of the mirror image
        # Of live motion: all but the movement until later frames.
        self.live = np.delete(np.arange(count), np.arange(2 * size, 3 * size))
        self.parts = [_part(joints, near, size, count) for joints, near in _PARTS]
        corrected = [j for part in self.parts for j in part.joints.tolist()]
        left = np.where(np.isin(known, corrected), known, self._mirror)
        self._slots = np.array([corrected.index(j) for j in left])
        sizes = [len(part.joints) for part in self.parts]
        self.part_of = np.repeat(np.arange(3), sizes)[self._slots]  # index, (M,)
        self.is_right = left != known  # of the known joints, shape (M,)
        self._share = np.where(self._mirror == known, 0.5, self.is_right)[:, None]

    def merge_sides(self, left: Array, right: Array) -> Array:
        """Return the offsets of all known joints, shape (..., M, 3).

        ``left`` and ``right`` are those of the joints of all parts, one part after the
        other, and of the same joints of the mirror image, shape (..., N, 3).
        """
        left, right = left[..., self._slots, :], right[..., self._slots, :]
        right = right * [-1.0, 1.0, 1.0]
        return np.asarray((1.0 - self._share) * left + self._share * right)

    def points(self, postures: Array) -> Array:
        """Return known joints relative to the middle of the hips [m], (..., M, 3)."""
        points = postures.take(self.joints, -2)
        return np.asarray(points - points.take(self._hips, -2).mean(-2, keepdims=True))

    def mirrored(self, points: Array) -> Array:
        """Return the mirror image of known joints, or of their offsets, (T, M, 3)."""
        return np.asarray(points[:, self._mirror] * [-1.0, 1.0, 1.0])

    def proportions(self, lengths: Array) -> Array:
        """Return log(limb length / standard length), less the mean of all limbs."""
        odd = np.log(lengths[self.limbs] / self._standard)
        return np.asarray(odd - odd.mean())

    def _bones(self, points: Array) -> Array:
        return points[..., 1:, :] - points.take(self._starts, -2)

    def __call__(
        self,
        points: Array,
        around: Array,
        time: Array,
        times: Array,
        toward: Array,
        *,
        live: bool = False,
    ) -> Singles:
        """Return the features of some frames of a motion, shape (T, F).

        ``points`` (T, M, 3) are their known joints [m], ``around`` (N, M, 3) those of
        all frames; ``time`` (T,) and ``times`` (N,) are the time stamps [s] of both,
        and ``toward`` (T, 2) is the direction to the sensor. If ``live``, the features
        that need later frames are left out.
        """
        parts = [points, _MOVEMENT * (points - values_at(times, around, time - _APART))]
        if not live:
            parts.append(_MOVEMENT * (values_at(times, around, time + _APART) - points))
        bones = self._bones(points)
        parts.append(_LENGTHS * (np.sqrt(np.vecdot(bones, bones)) - self._segments))
        rows = [part.reshape(len(points), -1) for part in (*parts, _TOWARD * toward)]
        return np.concatenate(rows, axis=1, dtype=np.float32)


def _part(
    joints: tuple[int, ...], near: tuple[int, ...], size: int, count: int
) -> Part:
    """Return a part with some joints, whose own features are those of ``near``."""
    own, rows = np.zeros(count, dtype=bool), np.array(near)
    own[:size].reshape(-1, 3)[rows] = True
    own[size : 3 * size] = np.tile(own[:size], 2)
    own[3 * size + rows[rows > 0] - 1] = True
    own[-2:] = True  # the direction to the sensor
    return Part(np.array(joints), own, np.where(own, 1.0, _REST).astype(np.float32))


class RandomFeatures:
    """Random features whose inner products approximate the kernel of the inputs.

    ``count``, which is even, is the number of features besides the linear ones,
    ``seed`` that of the frequencies. Mean and weights of the inputs have shape (F,).
    """

    def __init__(self, mean: Singles, count: int, seed: int, weights: Singles) -> None:
        self._frequencies = _frequencies(len(mean), count // 2, seed)
        self._mean, self._weights, self.size = mean, weights, count + len(mean)
        self._linear = weights * np.float32(np.sqrt(_LINEAR))

    def __call__(self, inputs: Singles) -> Singles:
        """Return the random and the linear features of frames, (T, size)."""
        half = self._frequencies.shape[1]
        features = np.empty((len(inputs), self.size), dtype=np.float32)
        angles = (inputs * self._weights) @ self._frequencies
        np.cos(angles, out=features[:, :half])
        np.sin(angles, out=features[:, half : 2 * half])
        features[:, : 2 * half] *= np.float32(1.0 / np.sqrt(half))
        features[:, 2 * half :] = (inputs - self._mean) * self._linear
        return features


@lru_cache(maxsize=8)  # every run of clean begins with the same ones
def _frequencies(size: int, count: int, seed: int) -> Singles:
    """Return orthogonal random frequencies, shape (size, count), read-only."""
    blocks = -(-count // size)
    # Raw bits and the normal quantile give the same numbers in every version of numpy.
    bits = np.random.PCG64(seed).random_raw(blocks * size * size) >> np.uint64(11)
    normal = ndtri((bits.astype(float) + 0.5) * 2.0**-53).reshape(blocks, size, size)
    turns = np.linalg.qr(normal)[0]
    lengths = np.linalg.norm(normal, axis=2, keepdims=True)
    rows = (turns * lengths).reshape(-1, size)[:count]
    frequencies: Singles = np.ascontiguousarray(rows.T, dtype=np.float32)
    frequencies.flags.writeable = False
    return frequencies


def direction_to(sensor: Array | None, count: int) -> Array:
    """Return horizontal unit vectors (T, 2), left and ahead, from people to the sensor.

    Without a sensor, or with one closer than 0.5 m, the direction is straight ahead.
    """
    if sensor is None:
        return np.tile([0.0, 1.0], (count, 1))
    flat = np.atleast_2d(sensor)[:, [0, 2]]
    distance = np.hypot(flat[:, 0], flat[:, 1])[:, None]
    return np.where(distance > 0.5, flat / np.maximum(distance, 0.5), [0.0, 1.0])


def similarity_to(features: Singles, centers: Singles, squares: Singles) -> Array:
    """Return the similarity of frames to the nearest center, in [0, 1], shape (T,).

    ``squares`` are the squared lengths of the centers.
    """
    if not len(centers):
        return np.zeros(len(features))
    nearest = (squares - 2.0 * features @ centers.T).min(axis=1)
    nearest = nearest + np.vecdot(features, features)
    return np.asarray(np.exp(-0.5 * np.maximum(nearest, 0.0)))


def turned_away(toward: Array) -> Array:
    """Return how far people are turned away from the sensor, beyond ``_TURNED`` [rad].

    ``toward`` (..., 2) is the direction to it. Positive to the left; opposite for those
    seen from behind, whom the sensor shows as if it saw them from the front.
    """
    left, ahead = -toward[..., 0], toward[..., 1]
    angle = np.arctan2(left, np.abs(ahead))
    beyond = np.maximum(np.abs(angle) - _TURNED, 0.0)
    return np.asarray(np.sign(left) * np.sign(ahead) * beyond)


def part_of_turn(toward: Array, share: float) -> Array:
    """Return a share of ``turned_away`` [rad], which ends at a right angle."""
    away = turned_away(toward)
    room = np.pi / 2.0 - _TURNED - np.abs(away)
    return np.asarray(np.sign(away) * np.minimum(share * np.abs(away), room))
