"""Filters over time, as baselines: Butterworth, Savitzky-Golay, Kalman."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, savgol_filter, sosfiltfilt

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Hold
from kinefilter.pipeline.correct.interface import (
    Correction,
    Corrector,
    Observation,
    measured_only,
)
from kinefilter.retarget import BoneLengths

SENSOR_NOISE, LOST_NOISE = 0.01, 0.3
"""Standard deviation [m] of a fully reliable joint, which jitters, and of an unreliable
one, which may be off by a forearm. Guesses."""
ACCELERATION_DENSITY = 2.5
"""Spectral density of the acceleration [m^2/s^3]: 5 m/s^2 for a tenth of a second."""
FIRST_SPEED = 1.0
"""Standard deviation of the velocity of a joint not seen before [m/s]."""
LONGEST_PREDICTION = 0.5
"""Time [s] for which a missing joint is taken to keep its velocity: half a reach."""

_LEAST_STEP = 1e-3  # s, between frames with the same time stamp
_IMMOVABLE = 1e6  # confidence in the root, which is the origin by definition


def bridge_gaps(time: Array, positions: Array) -> Array:
    """Return positions with gaps interpolated linearly in time.

    Before its first and after its last measurement a joint stays where it was seen; a
    joint that was never seen stays NaN.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], NaN where missing, shape (T, J, 3).
    """
    bridged = positions.copy()
    missing = np.isnan(positions[..., 0])
    for j in np.flatnonzero(missing.any(axis=0) & ~missing.all(axis=0)):
        gap = missing[:, j]
        for c in range(3):
            seen = positions[~gap, j, c]
            bridged[gap, j, c] = np.interp(time[gap], time[~gap], seen)
    return bridged


def _rate(time: Array) -> float:
    """Return the median frame rate [Hz], 0 for a single frame."""
    return 1.0 / float(np.median(np.diff(time))) if len(time) > 1 else 0.0


class WholeTake(Corrector):
    """A method that moves whole takes; joints that were never seen stay NaN."""

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Correct a whole take."""
        return measured_only(self._moved(take))

    @abstractmethod
    def _moved(self, take: Observation) -> Array:
        """Return the positions [m], shape (T, J, 3)."""


class Butterworth(WholeTake):
    """Low-pass filter over the frames, forward and backward, so without lag.

    Gaps are bridged first. A take shorter than the filter's padding, or with a frame
    rate that cannot hold the cutoff, is bridged only.

    Args:
        cutoff: Frequency [Hz] at which half of the amplitude is left: each of the two
            passes leaves 1 / sqrt(2).
        order: Order of one pass.
    """

    def __init__(
        self,
        skeleton: Skeleton | None = None,  # noqa: ARG002 - any will do
        *,
        cutoff: float = 6.0,
        order: int = 2,
    ) -> None:
        self.cutoff = cutoff
        self.order = order

    def _moved(self, take: Observation) -> Array:
        bridged, rate = bridge_gaps(take.time, take.positions), _rate(take.time)
        padding = 3 * (self.order + 1)
        if len(bridged) <= padding or 2.0 * self.cutoff >= rate:
            return bridged
        sections = butter(self.order, self.cutoff, fs=rate, output="sos")
        smooth = sosfiltfilt(sections, np.nan_to_num(bridged), 0, padlen=padding)
        return np.where(np.isnan(bridged), np.nan, smooth)


class SavitzkyGolay(WholeTake):
    """Least-squares polynomials over a sliding window, which have no lag.

    Gaps are bridged first. A take shorter than the window, or with so low a frame rate
    that a polynomial fits the window's frames exactly, is bridged only.

    Args:
        window_seconds: Length of the window [s], rounded to an odd number of frames.
        order: Order of the polynomials: motion of this order passes unchanged.
    """

    def __init__(
        self,
        skeleton: Skeleton | None = None,  # noqa: ARG002 - any will do
        *,
        window_seconds: float = 0.3,
        order: int = 3,
    ) -> None:
        self.window_seconds = window_seconds
        self.order = order

    def _moved(self, take: Observation) -> Array:
        bridged = bridge_gaps(take.time, take.positions)
        window = 2 * int(self.window_seconds * _rate(take.time) / 2.0) + 1
        if len(bridged) < window or window <= self.order + 1:
            return bridged
        smooth = savgol_filter(np.nan_to_num(bridged), window, self.order, axis=0)
        return np.where(np.isnan(bridged), np.nan, smooth)


def measurement_variance(reliability: Array) -> Array:
    """Return the variance of a coordinate [m^2] by the joint's reliability.

    The noise rises from a reliable to an unreliable joint's by equal factors.
    """
    return np.asarray(
        (LOST_NOISE ** (1.0 - reliability) * SENSOR_NOISE**reliability) ** 2
    )


class ConstantVelocity:
    """Kalman filters of points that keep their velocity, one for each joint.

    The coordinates of a joint are independent and share a covariance, so the state is
    two vectors, and the covariance 2 x 2. Measured positions [m] have shape (J, 3), the
    variance [m^2] of their coordinates (J,).

    Args:
        count: J, number of points.
    """

    def __init__(self, count: int) -> None:
        self.position = np.zeros((count, 3))
        """Estimated positions [m], shape (J, 3)."""
        self.velocity = np.zeros((count, 3))
        """Estimated velocities [m/s], shape (J, 3)."""
        self.covariance = np.zeros((count, 2, 2))
        """Of a coordinate's position and velocity, shape (J, 2, 2)."""

    def begin(
        self, which: NDArray[np.bool_], positions: Array, variance: Array
    ) -> None:
        """Begin points anew where they were measured, at an unknown velocity."""
        self.position[which], self.velocity[which] = positions[which], 0.0
        self.covariance[which] = 0.0
        self.covariance[which, 0, 0] = variance[which]
        self.covariance[which, 1, 1] = FIRST_SPEED**2

    def predict(self, step: float) -> None:
        """Go on for a time [s]."""
        self.position = self.position + step * self.velocity
        move = np.array([[1.0, step], [0.0, 1.0]])
        grow = np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
        self.covariance = move @ self.covariance @ move.T + ACCELERATION_DENSITY * grow

    def update(self, measured: Array, variance: Array) -> None:
        """Take measured positions in, NaN where there is none, shape (J, 3)."""
        missing = np.isnan(measured[:, :1])
        innovation = np.where(missing, 0.0, measured - self.position)
        total = self.covariance[:, 0, 0] + variance
        gain = np.where(missing, 0.0, self.covariance[:, :, 0] / total[:, None])
        self.position = self.position + gain[:, :1] * innovation
        self.velocity = self.velocity + gain[:, 1:] * innovation
        self.covariance = self.covariance - gain[:, :, None] * self.covariance[:, :1]

    def constrain(self, which: NDArray[np.bool_], positions: Array) -> None:
        """Move points to where they have to be, velocities as far as they correlate.

        Of the states with these positions it is the most likely; the covariance stays.
        """
        variance = np.where(which, self.covariance[:, 0, 0], 1.0)
        follow = (self.covariance[:, 0, 1] / variance)[:, None]
        moved = np.where(which[:, None], positions - self.position, 0.0)
        self.position = self.position + moved
        self.velocity = self.velocity + follow * moved


class ConstantLengthKalman(Corrector):
    """Tracks every joint, and keeps the bones at the standard body's lengths.

    After Tripathy, Chakravarty, Sinha, Chatterjee & Saha 2017, Constrained Kalman
    filter for improving Kinect based measurements, ISCAS: every joint is tracked by
    itself, then the estimates are moved to the nearest posture of constant lengths.

    The posture of constant lengths is the nearest by the filters' variances. A missing
    joint goes on at its velocity for up to half a second, then hangs on its last bone;
    one that was not yet seen hangs as in rest posture.

    Args:
        skeleton: The joints.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        body = standard_body(skeleton)
        self._bones = BoneLengths(body)
        self._rest, self._lengths = body.rest_offsets, body.lengths
        self._hold = Hold(skeleton)
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()
        self._points = ConstantVelocity(len(self.skeleton))
        self._unseen = np.full(len(self.skeleton), np.inf)
        self._time: float | None = None

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame; time stamps increase, and may start at 0."""
        missing = np.isnan(observation.positions[:, 0])
        followed = self._track(observation, missing)
        known = np.where(followed[:, None], self._points.position, np.nan)
        posture = self._hold.step(replace(observation, positions=known)).positions
        posture = self._with_lengths(posture, followed)
        self._points.constrain(followed, posture)
        confidence = np.where(missing, 0.0, 1.0)
        return Correction(posture, None, confidence, float("nan"))

    def _track(
        self, observation: Observation, missing: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Take a frame in and tell which joints have an estimate, shape (J,)."""
        measured, points = observation.positions, self._points
        variance = measurement_variance(observation.reliability)
        if self._time is not None:
            step = max(observation.time - self._time, _LEAST_STEP)
            points.predict(step)
            self._unseen = self._unseen + step
        self._time = observation.time
        lost = self._unseen > LONGEST_PREDICTION
        points.update(np.where(lost[:, None], np.nan, measured), variance)
        points.begin(lost & ~missing, measured, variance)
        self._unseen = np.where(missing, self._unseen, 0.0)
        return self._unseen <= LONGEST_PREDICTION

    def _with_lengths(self, posture: Array, followed: NDArray[np.bool_]) -> Array:
        """Return the nearest posture of constant bone lengths, root at the origin."""
        variance = np.where(followed, self._points.covariance[:, 0, 0], np.inf)
        confidence = np.ones(len(posture))
        if followed.any():
            confidence = variance.min() / variance
        confidence[self.skeleton.root] = _IMMOVABLE
        near = self._bones.project(posture[None], confidence[None])[0]
        # What is left, above all of a torn skeleton, goes to the outer joints.
        exact = np.zeros((len(posture), 3))
        for j in self.skeleton.order[1:]:
            parent = self.skeleton.parents[j]
            bone = near[j] - near[parent]
            length = float(np.sqrt(bone @ bone))
            bone = bone * (self._lengths[j] / length) if length > 0.0 else self._rest[j]
            exact[j] = exact[parent] + bone
        return exact
