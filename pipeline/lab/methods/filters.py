"""Filters over time, as baselines: Butterworth, Savitzky-Golay, One-Euro, Kalman."""

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import frames_per_second
from kinefilter.pipeline.correct import Correction, Corrector, Hold, Observation
from kinefilter.pipeline.correct.interface import measured_only
from kinefilter.pipeline.merge.lag import interpolate_gaps
from kinefilter.retarget import BoneLengths
from kinefilter.retarget.standardize import chain_matrix

SENSOR_NOISE, LOST_NOISE = 0.01, 0.3  # m, reliable and lost: deviations, guesses
ACCELERATION_DENSITY = 2.5  # m^2/s^3: 5 m/s^2 for a tenth of a second
FIRST_SPEED = 1.0  # m/s: standard deviation for a joint not seen before
LONGEST_PREDICTION = 0.5  # s that a missing joint keeps its velocity: half a reach

_LEAST_STEP = 1e-3  # s, between frames with the same time stamp
_IMMOVABLE = 1e6  # confidence in the root, which is the origin by definition


def bridge_gaps(time: Array, positions: Array) -> Array:
    """Return positions (T, J, 3) [m] with gaps bridged in time [s], held at ends."""
    columns = positions.reshape(len(positions), -1)
    bridged = interpolate_gaps(time, columns).reshape(positions.shape)
    return np.where(np.isnan(positions).all(axis=0), np.nan, bridged)


@dataclass
class WholeTake(Corrector):
    """A method that filters whole takes; joints that were never seen stay NaN."""

    skeleton: Skeleton | None = None  # not needed, but given to all methods

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - all frames at once
    ) -> Correction:
        """Correct a whole take."""
        return measured_only(self._filtered(take))

    @abstractmethod
    def _filtered(self, take: Observation) -> Array:
        """Return the filtered positions [m], shape (T, J, 3)."""


@dataclass
class Butterworth(WholeTake):
    """Low-pass filter over the frames, run forward and backward so that it has no lag.

    Gaps are bridged first; takes shorter than the padding, or of too low a frame rate
    for the cutoff, get nothing else.
    """

    _: KW_ONLY
    cutoff: float = 6.0  # Hz, at which both passes leave half of the amplitude
    order: int = 2  # order of one pass

    def _filtered(self, take: Observation) -> Array:
        bridged = bridge_gaps(take.time, take.positions)
        rate = frames_per_second(take.time)
        padding = 3 * (self.order + 1)
        if len(bridged) <= padding or 2.0 * self.cutoff >= rate:
            return bridged
        sections = butter(self.order, self.cutoff, fs=rate, output="sos")
        return np.asarray(sosfiltfilt(sections, bridged, 0, padlen=padding))


@dataclass
class SavitzkyGolay(WholeTake):
    """Least-squares polynomials over a sliding window, without lag.

    Gaps are bridged first; takes shorter than the window, or with too few frames in it
    for the polynomial, get nothing else.
    """

    _: KW_ONLY
    window_seconds: float = 0.3  # s, rounded to an odd number of frames
    order: int = 3  # order of the polynomials: motion of this order passes unchanged

    def _filtered(self, take: Observation) -> Array:
        bridged = bridge_gaps(take.time, take.positions)
        window = 2 * int(self.window_seconds * frames_per_second(take.time) / 2.0) + 1
        if len(bridged) < window or window <= self.order + 1:
            return bridged
        smooth = savgol_filter(np.nan_to_num(bridged), window, self.order, axis=0)
        return np.where(np.isnan(bridged), np.nan, smooth)


def measurement_variance(reliability: Array) -> Array:
    """Return a coordinate's variance [m^2], geometric in the joint's reliability."""
    deviation = LOST_NOISE ** (1.0 - reliability) * SENSOR_NOISE**reliability
    return np.asarray(deviation**2)


class ConstantVelocity:
    """Constant-velocity Kalman filters, one for each of J points.

    A point's coordinates are independent and share a 2 x 2 covariance. Measured
    positions [m] have shape (J, 3), the variance [m^2] of their coordinates (J,).
    """

    def __init__(self, count: int) -> None:
        self.position = np.zeros((count, 3))  # estimated [m]
        self.velocity = np.zeros((count, 3))  # estimated [m/s]
        self.covariance = np.zeros((count, 2, 2))  # of a coordinate's two estimates

    def begin(self, which: Flags, positions: Array, variance: Array) -> None:
        """Reset points to their measured positions, with unknown velocity."""
        self.position[which], self.velocity[which] = positions[which], 0.0
        self.covariance[which] = 0.0
        self.covariance[which, 0, 0] = variance[which]
        self.covariance[which, 1, 1] = FIRST_SPEED**2

    def predict(self, step: float) -> None:
        """Advance the estimates by a time [s]."""
        self.position = self.position + step * self.velocity
        move = np.array([[1.0, step], [0.0, 1.0]])
        grow = np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
        self.covariance = move @ self.covariance @ move.T + ACCELERATION_DENSITY * grow

    def update(self, measured: Array, variance: Array) -> None:
        """Update the estimates by measured positions, NaN where missing, (J, 3)."""
        missing = np.isnan(measured[:, :1])
        innovation = np.where(missing, 0.0, measured - self.position)
        total = self.covariance[:, 0, 0] + variance
        gain = np.where(missing, 0.0, self.covariance[:, :, 0] / total[:, None])
        self.position = self.position + gain[:, :1] * innovation
        self.velocity = self.velocity + gain[:, 1:] * innovation
        self.covariance = self.covariance - gain[:, :, None] * self.covariance[:, :1]

    def constrain(self, which: Flags, positions: Array) -> None:
        """Move points to positions, and velocities by their correlation."""
        variance = np.where(which, self.covariance[:, 0, 0], 1.0)
        follow = (self.covariance[:, 0, 1] / variance)[:, None]
        moved = np.where(which[:, None], positions - self.position, 0.0)
        self.position = self.position + moved
        self.velocity = self.velocity + follow * moved


class BoneWalk:
    """Changes the lengths of bones and keeps their directions (Chiang, eq. 1, 2)."""

    def __init__(self, skeleton: Skeleton) -> None:
        rest = standard_body(skeleton)
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._rest = rest.directions[self._ends]
        self.lengths = rest.lengths[self._ends]  # of the standard body [m], (S,)
        self._chain = chain_matrix(skeleton)[:, self._ends].copy("C")

    def measure(self, postures: Array) -> tuple[Array, Array]:
        """Return the bones' directions (..., S, 3), and lengths [m] (..., S)."""
        bones = postures[..., self._ends, :] - postures[..., self._starts, :]
        lengths = np.sqrt(np.sum(bones * bones, axis=-1))
        valid = (lengths > 1e-6)[..., None]
        directions = bones / np.where(valid, lengths[..., None], 1.0)
        return np.where(valid, directions, self._rest), lengths

    def posture(self, directions: Array, lengths: Array) -> Array:
        """Return the posture [m] with these bones, root at the origin, (..., J, 3)."""
        return np.asarray(self._chain @ (directions * lengths[..., None]))

    def standardized(self, postures: Array) -> Array:
        """Return postures (..., J, 3) with standard bones, root at the origin."""
        return self.posture(self.measure(postures)[0], self.lengths)


class ConstantLengthKalman(Corrector):
    """Tracks every joint, and keeps the bones at the standard body's lengths.

    After Tripathy, Chakravarty, Sinha, Chatterjee & Saha 2017, "Constrained Kalman
    filter for improving Kinect based measurements", ISCAS: every joint is tracked by
    itself, then the estimates are moved to the nearest posture of constant lengths, by
    the filters' variances. A missing joint keeps its velocity for up to half a second,
    then hangs on its last bone; one that was never seen hangs as in the rest pose.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self._bones = BoneLengths(standard_body(skeleton))
        self._walk = BoneWalk(skeleton)
        self._hold = Hold(skeleton)
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._hold.start()
        self._points = ConstantVelocity(len(self.skeleton))
        self._unseen = np.full(len(self.skeleton), np.inf)  # s since last measured
        self._time: float | None = None

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame; time stamps increase, and may start at 0."""
        missing = np.isnan(observation.positions[:, 0])
        tracked = self._track(observation, missing)
        known = np.where(tracked[:, None], self._points.position, np.nan)
        posture = self._hold.step(replace(observation, positions=known)).positions
        posture = self._with_lengths(posture, tracked)
        self._points.constrain(tracked, posture)
        return Correction(posture, np.where(missing, 0.0, 1.0), float("nan"))

    def _track(self, observation: Observation, missing: Flags) -> Flags:
        """Update the filters; return which joints have an estimate, shape (J,)."""
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

    def _with_lengths(self, posture: Array, tracked: Flags) -> Array:
        variance = np.where(tracked, self._points.covariance[:, 0, 0], np.inf)
        confidence = np.ones(len(posture))
        if tracked.any():
            confidence = variance.min() / variance
        confidence[self.skeleton.root] = _IMMOVABLE
        near = self._bones.project(posture[None], confidence[None])[0]
        # The remaining error, largest for a torn skeleton, goes to the outer joints.
        return self._walk.standardized(near)


@dataclass(eq=False, repr=False)
class OneEuro(Corrector):
    """Low-pass filter whose cutoff rises with speed: steady at rest, prompt in motion.

    Casiez, Roussel & Vogel 2012, 1 Euro Filter, CHI '12. The three coordinates of a
    joint share one cutoff, so the result does not depend on the axes. Missing joints
    keep their last bones; joints not measured yet are placed as in the rest pose.
    """

    skeleton: Skeleton
    _: KW_ONLY
    min_cutoff: float = 1.0  # cutoff at rest [Hz]
    beta: float = 16.0
    """Rise of the cutoff with speed [1/m]. In steady motion a joint lags by less than
    1 / (2 pi beta)."""
    derivative_cutoff: float = 1.0  # cutoff of the speed itself [Hz]

    def __post_init__(self) -> None:
        self._hold = Hold(self.skeleton)
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._hold.start()
        self._time: float | None = None
        self._velocity = np.zeros((len(self.skeleton), 3))

    def step(self, observation: Observation) -> Correction:
        """Filter the next frame; time stamps increase, and may start at 0."""
        measured = observation.positions
        if self._time is not None:
            step = max(observation.time - self._time, _LEAST_STEP)
            measured = self._filter(measured, step)
        self._time = observation.time
        return self._hold.step(replace(observation, positions=measured))

    def _filter(self, positions: Array, step: float) -> Array:
        """Return the filtered frame [m], NaN where missing, (J, 3) (algorithm 1)."""
        last, known = self._hold.last, self._hold.measured[:, None]
        change = np.where(known, positions - last, 0.0)
        # A missing joint is held, so it comes to rest.
        velocity = np.where(np.isnan(change), 0.0, change) / step
        share = _newest_share(np.array(self.derivative_cutoff), step)
        self._velocity = self._velocity + share * (velocity - self._velocity)
        speed = np.linalg.norm(self._velocity, axis=1, keepdims=True)
        cutoff = self.min_cutoff + self.beta * speed
        smooth = last + _newest_share(cutoff, step) * change
        return np.where(known, smooth, positions)


def _newest_share(cutoff: Array, step: float) -> Array:
    """Return alpha, the share of the newest value in exponential smoothing."""
    turn = 2.0 * np.pi * cutoff * step
    return np.asarray(turn / (turn + 1.0))
