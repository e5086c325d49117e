"""How steeply feet point, predicted from how the legs move.

Kinect hardly shows it: its toes are 14 to 16 degrees off in walks, where a foot that is
always flat is 15 to 19 degrees off. Thighs and shanks, which it shows well, tell when a
heel rises, when toes clear the floor, and when a heel strikes. The weights are those of
a kernel ridge regression (``pipeline.lab.foot_lessons``) on thighs, shanks and heights
of the ankles of both legs up to 0.3 s before and after.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, Singles, chunks
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.correct.posture_features import (
    RandomFeatures,
    similarity_to,
    values_at,
)
from kinefilter.pipeline.formats.npz import read_arrays
from kinefilter.retarget import HeadingFrame

from .feet import ankles_and_toes, flat_height
from .possible_postures import hips_yaw

_AROUND = np.arange(-3, 4) * 0.1  # s: the frames that describe the motion
_HEIGHT = 3.0  # weight of an ankle's height [m], against 1 for components of directions
_CHUNK = 512  # frames at a time
# rad of a foot on the floor that are due to errors, and that are not at all. Chosen on
# s02, s03 and s04 and CMU's people 02, 06, 07, 10, 16, 29 and 32.
_FLAT, _CLEAR = np.radians([5.0, 15.0])
_HEEL_ERROR, _OTHERS_HEEL_ERROR = 0.07, 0.03
"""How much higher [m] than of a flat foot an ankle is whose heel has left the floor: in
a Kinect's takes, which err more, and in others. Chosen on walks of people 02, 05, 07,
16 and 29 of CMU and on every fourth recorded take."""
_ARRAYS = ("mean", "scale", "weights", "centers")
# Similarity to the training data at which none, and all, of the prediction counts.
_STRANGE, _FAMILIAR = 0.7, 0.85


class FootPitch:
    """Predicts the pitch of feet; the arrays are those that ``arrays`` returns."""

    def __init__(
        self, mean: Singles, scale: Singles, weights: Singles, centers: Singles
    ) -> None:
        self._mean, self._scale = mean, scale
        self._weights, self._centers = weights, centers
        self._features = RandomFeatures(mean, len(weights) - len(mean), 0, scale)
        self._scaled = (centers - mean) * scale
        self._squares = np.vecdot(self._scaled, self._scaled)

    def arrays(self) -> dict[str, Singles]:
        """Return what the prediction consists of, for a file."""
        arrays = self._mean, self._scale, self._weights, self._centers
        return dict(zip(_ARRAYS, arrays, strict=True))

    def __call__(
        self, time: Array, positions: Array, skeleton: Skeleton
    ) -> tuple[Array, Array]:
        """Return pitch [rad], toes up, 0 if flat, and how familiar it is, (T, 2).

        Joint positions [m], (T, J, 3), have the floor at y = 0. Columns are left and
        right; familiarity is in [0, 1].
        """
        return self.predicted(described(time, positions, skeleton))

    def predicted(self, inputs: Singles) -> tuple[Array, Array]:
        """Return the same for inputs that are ``described``, shape (T, 2, F)."""
        pitch, near = np.empty((2, *inputs.shape[:2]))
        for k in chunks(len(inputs), _CHUNK):
            for foot in range(2):
                rows = inputs[k, foot]
                pitch[k, foot] = self._features(rows) @ self._weights
                scaled = (rows - self._mean) * self._scale
                near[k, foot] = similarity_to(scaled, self._scaled, self._squares)
        return pitch, ((near - _STRANGE) / (_FAMILIAR - _STRANGE)).clip(0.0, 1.0)


def described(time: Array, positions: Array, skeleton: Skeleton) -> Singles:
    """Return the inputs of the prediction for the left and the right foot, (T, 2, F)."""
    yaw = hips_yaw(positions, skeleton)
    joints = HeadingFrame(np.zeros_like(positions[:, 0]), yaw).remove(positions)
    hips, knees, ankles = (
        joints[:, skeleton.sides(part)] for part in ("Hip", "Knee", "Ankle")
    )
    thighs, shanks = unit(knees - hips)[..., 1:], unit(ankles - knees)[..., 1:]
    legs = np.concatenate([thighs, shanks, _HEIGHT * ankles[..., 1:2]], axis=2)
    both = np.concatenate([legs, legs[:, ::-1]], axis=2)  # its own first, (T, 2, 10)
    around = [values_at(time, both, time + away) for away in _AROUND]
    return np.concatenate(around, axis=2, dtype=np.float32)


def foot_pitches(
    time: Array, positions: Array, stands: Flags, body: Body, *, by_kinect: bool
) -> Array:
    """Return the pitch of feet [rad], toes up, 0 if flat, shape (T, 2).

    In a Kinect's takes it is predicted where legs move as in the training data; else it
    is as shown, but that of a planted foot is as high as its ankle is beyond errors.
    """
    shown, held = pitch_of(positions, body), _held(positions, body, by_kinect)
    if by_kinect:
        predicted, familiar = foot_pitch()(time, positions, body.skeleton)
        moving = shown + familiar * (predicted - shown)
        resting = held + familiar * (_clear(predicted) - held)
    else:
        moving, resting = shown, _clear(shown)
    pitch = np.where(stands, resting, moving)
    return pitch.clip(flat_angle(body, ankles_and_toes(body.skeleton)[1][0]) - 0.5 * np.pi, 1.2)


def _clear(pitch: Array) -> Array:
    """Return the pitch of feet on the floor [rad]: nearly flat ones are flat."""
    return np.asarray(pitch * ((np.abs(pitch) - _FLAT) / (_CLEAR - _FLAT)).clip(0.0, 1.0))


def _held(positions: Array, body: Body, by_kinect: bool) -> Array:
    """Return the pitch of feet whose ankles are higher than errors lift them."""
    ankles, toes = ankles_and_toes(body.skeleton)
    flat, sole, length = flat_height(body, toes[0]), body.radii[toes[0]], body.lengths[toes[0]]
    error = _HEEL_ERROR if by_kinect else _OTHERS_HEEL_ERROR
    rise = np.maximum(positions[:, ankles, 1] - flat - error, 0.0)
    # A leg that the edge of the view cuts off ends higher than a heel can be.
    most = sole + length - flat
    rise = np.minimum(rise, np.maximum(2.0 * most - rise, 0.0))
    sine = ((flat + rise - sole) / length).clip(-1.0, 1.0)
    return np.asarray(flat_angle(body, toes[0]) - np.arcsin(sine))


def pitch_of(positions: Array, body: Body) -> Array:
    """Return how far ankle and toes are from those of a flat foot [rad], (T, 2)."""
    ankles, toes = ankles_and_toes(body.skeleton)
    rise = unit(positions[:, toes] - positions[:, ankles])[..., 1]
    return np.asarray(np.arcsin(rise) + flat_angle(body, toes[0]))


def flat_angle(body: Body, toe: int) -> float:
    """Return the angle [rad] by which toes are below the ankle of a flat foot."""
    fall = flat_height(body, toe) - body.radii[toe]
    return float(np.arcsin(fall / body.lengths[toe]))


@cache
def foot_pitch() -> FootPitch:
    """Return the shipped prediction."""
    path = Path(__file__).parents[1] / "embedded" / "foot_pitch.npz"
    arrays = read_arrays(path, "weights of feet")
    return FootPitch(*(arrays[name].astype(np.float32) for name in _ARRAYS))
