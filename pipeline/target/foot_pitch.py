"""How steeply feet point, predicted from how the legs move.

Kinect hardly shows it: in walks its toes point 15 degrees off, hardly less than those
of feet that are always flat. Thighs and shanks, which it shows well, tell when a heel
rises, when toes clear the floor, and when a heel strikes. The weights are those of a
kernel ridge regression (``pipeline.lab.foot_lessons``) on thighs, shanks and heights of
the ankles of both legs in the last 0.3 s: later frames hardly help.

Pitches are angles [rad] of feet, left and right, toes up, 0 if flat. Joint positions
[m], (T, J, 3), have the floor at y = 0.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, Singles, chunks
from kinefilter.characters.motion import values_at
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.correct.posture_features import (
    RandomFeatures,
    similarity_to,
)
from kinefilter.pipeline.formats.npz import read_arrays

from .feet import ankles_and_toes, flat_height

_BEFORE = np.array([0.3, 0.2, 0.1, 0.0])  # s: the frames that describe the motion
_HEIGHT = 3.0  # weight of an ankle's height [m], against 1 for components of directions
_CHUNK = 256  # frames at a time
# Similarity to the training data at which none, and all, of the prediction counts, and
# pitches [rad] of planted feet that are due to errors, and that are not at all: as
# predicted, and as shown. Chosen on s02, s03 and s04 and CMU's people 02, 06, 07, 10,
# 16, 29 and 32.
_STRANGE, _FAMILIAR = 0.7, 0.85
_FLAT, _SHOWN_FLAT = np.radians([10.0, 20.0]), np.radians([5.0, 15.0])


class FootPitch:
    """Predicts pitches; the arrays are those that ``arrays`` returns.

    They are the mean and the weights of the inputs, shape (F,), the weights of their
    random features, (N,), and centers of the weighted inputs in the training data.
    """

    NAMES = ("mean", "scale", "weights", "centers")

    def __init__(self, *arrays: Singles) -> None:
        self._mean, self._scale, self._weights, self._centers = arrays
        zeros, count = np.zeros_like(self._mean), len(self._weights) - len(self._mean)
        self._features = RandomFeatures(zeros, count, 0, zeros + 1)
        self._squares = np.vecdot(self._centers, self._centers)

    @classmethod
    def load(cls, path: Path) -> FootPitch:
        """Read a file of ``arrays``."""
        arrays = read_arrays(path, "weights of feet")
        return cls(*(arrays[name].astype(np.float32) for name in cls.NAMES))

    def arrays(self) -> dict[str, Singles]:
        """Return the arrays by name."""
        arrays = self._mean, self._scale, self._weights, self._centers
        return dict(zip(self.NAMES, arrays, strict=True))

    def __call__(self, inputs: Singles) -> tuple[Array, Array]:
        """Return pitches, and how familiar the motion is, in [0, 1], both (N, 2).

        Inputs, (N, 2, F), are those that ``described`` returns.
        """
        rows = ((inputs - self._mean) * self._scale).reshape(-1, len(self._mean))
        pitch = (self._features(rows) @ self._weights).astype(float)
        near = similarity_to(rows, self._centers, self._squares)
        familiar = ((near - _STRANGE) / (_FAMILIAR - _STRANGE)).clip(0.0, 1.0)
        return pitch.reshape(-1, 2), familiar.reshape(-1, 2)


@cache
def foot_pitch() -> FootPitch:
    """Return the shipped prediction."""
    return FootPitch.load(Path(__file__).parents[1] / "embedded" / "foot_pitch.npz")


def legs_of(positions: Array, skeleton: Skeleton) -> Array:
    """Return what describes both legs, that of each foot first, shape (T, 2, 10)."""
    hips, knees, ankles = (
        positions[:, skeleton.sides(part)] for part in ("Hip", "Knee", "Ankle")
    )
    left = hips[:, :1] - hips[:, 1:]
    ahead = unit(left[..., ::-2] * [-1.0, 1.0])  # x and z, horizontal
    bones = unit(np.stack([knees - hips, ankles - knees]))
    legs = np.empty((len(positions), 2, 5))
    legs[..., 0:4:2] = np.moveaxis(bones[..., 1], 0, 2)
    legs[..., 1:4:2] = np.moveaxis(np.vecdot(bones[..., ::2], ahead), 0, 2)
    legs[..., 4] = _HEIGHT * ankles[..., 1]
    return np.concatenate([legs, legs[:, ::-1]], axis=2)


def described(time: Array, legs: Array, now: Array) -> Singles:
    """Return the inputs of the prediction at some time stamps [s], shape (N, 2, F).

    ``legs`` (T, 2, 10) are ``legs_of`` the frames with other time stamps, (T,).
    """
    rows = values_at(time, legs, now[:, None] - _BEFORE).swapaxes(1, 2)
    return rows.reshape(len(now), 2, -1).astype(np.float32)


def foot_pitches(
    time: Array, positions: Array, shown: Array, stands: Flags, body: Body
) -> Array:
    """Return the pitches in a take, shape (T, 2), of feet that may be planted, (T, 2).

    They are as in ``positions`` as far as the toes are ``shown`` there, 0 to 1, (T, 2).
    Else they are predicted where the legs move as in the training data. Where they do
    not, planted feet are flat, and others point as in ``positions``.
    """
    legs, pitch = legs_of(positions, body.skeleton), np.empty(stands.shape)
    for k in chunks(len(time), _CHUNK):
        frames = positions[k], shown[k], stands[k]
        pitch[k] = _found(described(time, legs, time[k]), *frames, body)
    return pitch


class PitchTracker:
    """Finds the pitches of live motion, frame by frame, as ``foot_pitches``."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._time, self._legs = np.empty(0), np.empty((0, 2, 10))

    def step(self, time: float, positions: Array, shown: Array, stands: Flags) -> Array:
        """Return the pitches in the next frame, shape (2,)."""
        recent = self._time > time - 2.0 * _BEFORE[0]
        self._time = np.append(self._time[recent], time)
        legs = legs_of(positions[None], self._body.skeleton)
        self._legs = np.concatenate([self._legs[recent], legs])
        inputs = described(self._time, self._legs, self._time[-1:])
        found = _found(inputs, positions[None], shown, stands, self._body)
        return np.asarray(found[0])


def _found(
    inputs: Singles, positions: Array, shown: Array, stands: Flags, body: Body
) -> Array:
    """Return the pitches of frames with some inputs of the prediction, (T, 2)."""
    predicted, familiar = foot_pitch()(inputs)
    seen = pitch_of(positions, body)
    usual = np.where(stands, 0.0, seen)
    predicted = np.where(stands, _clear(predicted, _FLAT), predicted)
    pitch = usual + familiar * (predicted - usual)
    pitch += shown * (np.where(stands, _clear(seen, _SHOWN_FLAT), seen) - pitch)
    # A foot that stands on its toes does not tip over them.
    return np.maximum(pitch, flat_angle(body) - 0.5 * np.pi)


def pitch_of(positions: Array, body: Body) -> Array:
    """Return the pitches of joints [m], (..., J, 3), shape (..., 2)."""
    ankles, toes = ankles_and_toes(body.skeleton)
    rise = unit(positions[..., toes, :] - positions[..., ankles, :])[..., 1]
    return np.asarray(np.arcsin(rise.clip(-1.0, 1.0)) + flat_angle(body))


def flat_angle(body: Body) -> float:
    """Return the angle [rad] by which toes are below the ankle of a flat foot."""
    toe = ankles_and_toes(body.skeleton)[1][0]
    fall = flat_height(body, toe) - body.radii[toe]
    return float(np.arcsin(fall / body.lengths[toe]))


def _clear(pitch: Array, limits: Array) -> Array:
    """Return the pitch of a foot on the floor: one that is nearly flat is flat."""
    share = (np.abs(pitch) - limits[0]) / (limits[1] - limits[0])
    return np.asarray(pitch * share.clip(0.0, 1.0))
