"""Finds the clock and frame of a second sensor relative to a first, from the motion.

The clocks come first: sensors agree best on the heights of joints above each other,
which are the same from any side, and whose rise and fall tells the lag. Then one rigid
transform lays the second sensor's trunks onto the first's. How well joints move
together after that refines the lag, and how the lag changes tells the drift.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, find_peaks, sosfiltfilt
from scipy.spatial.transform import Rotation

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.skeleton import LIMB_PARTS
from kinefilter.pipeline.reliability import column_medians

from .lag import MIN_WINDOWS, Clock, Spline, correlations, interpolate_gaps, with_drift
from .rigid import SIGMA, Placement, placement

_RATE = 20.0  # samples a second to search lags in: joints move below 5 Hz
_BAND = (0.2, 5.0)  # Hz: slower is where people stand, faster is noise
_LARGE = 0.1  # m beyond which larger movement hardly counts more
_MIN_COMMON = 2.0  # s that both recordings must have in common
_CANDIDATES = 6  # lags for which a placement is tried
_FRAMES = 1000  # enough to place a sensor
_UNEXPLAINED = 0.30  # m of error that costs as much as a frame only one sensor has
_MAX_COST = np.log1p((_UNEXPLAINED / SIGMA) ** 2)
_WORST = 1.5
"""Cost of a fit above which two takes do not show the same movement. Chosen on p00 to
p08 of two-kinects: true pairs in which people move cost 1.4 or less there, takes of
different sessions 1.7 or more. A guess where less than half a take is in common."""
_LIKELY = 0.5  # certainty below which the lag may be chance. Chosen there, too
_MIN_PATH = 0.5  # m that people must walk, or the placement rests on their body alone
_SMOOTH, _EVEN = 3.0, 60.0
"""Cutoff [Hz] and sampling rate [1/s] for refining lags. Interpolation between frames
removes noise, which would draw the lag to where it does."""
_STEP = 0.2  # s over which movements are compared
_MOVED = 0.01  # m by which they may differ
_AROUND = 0.12  # s by which a first lag may be off
_PRECISION = 5e-4  # s
_MIN_JOINTS = 10  # joints, over all frames, that determine a lag
_WINDOW, _MAX_WINDOWS = 8.0, 80  # s of each window whose lag shows the drift
_EDGE = 5e-3  # s from the end of the search
_SPAN, _LONGER = 600.0, 4.0
"""Length [s] of the first span that is searched for drift, and the factor by which it
grows. A clock that gains 0.2 ms a second is off by 0.06 s at the ends of the first."""


class Alignment(NamedTuple):
    """A second sensor's clock and place relative to those of the first."""

    clock: Clock  # the second clock's time at times of the first
    placed: Placement  # from the second sensor's frame to the first's
    trunk_distance: float  # median distance between the joints of the two trunks [m]
    certainty: float  # of the lag: Fisher's z (correlation) * sqrt(common seconds)
    path: float  # how far people walked over the floor [m]
    explained: float = 0.0  # share of the first take explained by the second, in [0, 1]

    @property
    def clock_is_sure(self) -> bool:
        """True if there is enough movement to determine the lag."""
        return self.certainty >= _LIKELY or self.place_is_sure

    @property
    def place_is_sure(self) -> bool:
        """True if people walked far enough to determine where the sensor is.

        A standing person is seen well enough to merge, but sensors may see a standing
        body turned by up to 30 degrees.
        """
        return self.path >= _MIN_PATH


_HERE = Placement(Rotation.identity(), np.zeros(3))
IDENTITY = Alignment(Clock(0.0, 0.0), _HERE, 0.0, np.inf, np.inf)  # of the first sensor


def align(first: Take, second: Take) -> Alignment:
    """Return the clock and place of the second take's sensor relative to the first's.

    Neither sensor has to be calibrated, and their clocks may be unrelated. If the
    skeletons differ, joints of the same name are compared. Raises InputError if the
    takes do not show the same movement, or are identical.
    """
    both = f"{first.source} and {second.source}"
    if np.array_equal(first.positions, second.positions, equal_nan=True):
        raise InputError(f"{both}: the takes are identical; give one take per sensor")
    lags, correlation, samples = correlations(_movement(first), _movement(second))
    seconds = samples / _RATE
    certainties = np.arctanh(np.clip(correlation, -0.999, 0.999)) * np.sqrt(seconds)
    certainties[(seconds < _MIN_COMMON) | np.isnan(certainties)] = -np.inf
    peaks, _ = find_peaks(np.pad(certainties, 1, constant_values=-np.inf))
    peaks = peaks[np.isfinite(certainties[peaks - 1])] - 1
    if not len(peaks):
        raise InputError(
            f"{both}: the takes never show a person at the same time for "
            f"{_MIN_COMMON:g} s, at any lag; give takes of the same time"
        )
    # A sensor behind the person has left and right swapped.
    pairs = [TwoTakes(first, take) for take in (second, second.swapped())]
    fits = []
    for k in peaks[np.argsort(-certainties[peaks])][:_CANDIDATES]:
        clock = Clock(float(first.time[0]), float(second.time[0] + lags[k] / _RATE))
        for pair in pairs:
            placed, cost, _ = pair.place(clock)
            fits.append((cost, clock, placed, pair, float(certainties[k])))
    cost, clock, placed, pair, certainty = min(fits, key=lambda fit: fit[0])
    if cost > _WORST:
        raise InputError(
            f"{both}: the takes do not show the same movement at any lag; give takes "
            "of the same people at the same time, from sensors that stand still; takes "
            "of different times are cleaned one by one, or with 'kinefilter batch'"
        )
    clock = pair.refine(clock, placed)
    placed, _, _ = pair.place(clock)
    clock = pair.find_drift(clock, placed)
    placed, _, distance = pair.place(clock)
    explained = 1.0 - cost / _MAX_COST
    return Alignment(clock, placed, distance, certainty, _path(first), explained)


def _path(take: Take) -> float:
    """Return how far people walked over the floor [m]."""
    places = take.positions[:, take.skeleton.root, ::2]
    places = places[~np.isnan(places).any(axis=1)]
    if not len(places):
        return 0.0
    low, high = np.percentile(places, (5.0, 95.0), axis=0)
    return float(np.hypot(*(high - low)))


def _movement(take: Take) -> Array:
    """Return how joints rise and fall, without unit, _RATE rows per second, (N, F).

    Paired joints count by their mean height and by the difference between the two, so
    that swapped sides do not matter; so does the speed over the floor.
    """
    times = np.arange(take.time[0], take.time[-1], 1.0 / _RATE)
    positions, skeleton = take.positions, take.skeleton
    height = Spline(take.time, positions[..., 1:2]).at(times)[..., 0]
    root = Spline(take.time, positions[:, [skeleton.root]]).at(times)[:, 0]
    height = height - root[:, 1:2]
    columns = [root[:, 1], *height[:, _spine(skeleton)[1:]].T]
    for limb in LIMB_PARTS:
        left, right = height[:, skeleton.sides(limb)].T
        columns += [0.5 * (left + right), np.abs(left - right)]
    values = np.stack(columns, axis=1)
    steps = np.gradient(_median_filled(root[:, ::2]), 1.0 / _RATE, axis=0)
    speed = np.linalg.norm(_filtered(steps, 2.0), axis=1)
    speed[np.isnan(root[:, 0])] = np.nan
    slow = _filtered(_median_filled(values), _BAND) / _LARGE
    fast = _filtered(_median_filled(speed[:, None]), 3.0) * 0.1 / _LARGE
    found = np.tanh(np.hstack([slow, fast]))
    return np.where(np.isnan(np.column_stack([values, speed])), np.nan, found)


def _smoothed(take: Take) -> Spline:
    """Return the tracked joints that determine the lag, low-passed, at even times."""
    joints = _spine(take.skeleton)
    joints += [joint for limb in LIMB_PARTS for joint in take.skeleton.sides(limb)]
    tracked = (take.state == State.TRACKED)[:, joints, None]
    spline = Spline(take.time, np.where(tracked, take.positions[:, joints], np.nan))
    times = np.arange(spline.time[0], spline.time[-1], 1.0 / _EVEN)
    flat = spline.at(times).reshape(len(times), -1)
    even = _filtered(interpolate_gaps(times, flat), _SMOOTH, _EVEN)
    even[np.isnan(flat)] = np.nan
    return Spline(times, even.reshape(len(times), len(joints), 3))


def _median_filled(values: Array) -> Array:
    return np.where(np.isnan(values), np.nan_to_num(column_medians(values)), values)


def _filtered(
    values: Array, edges: float | tuple[float, float], rate: float = _RATE
) -> Array:
    """Return columns low-passed, or band-passed between two edges [Hz]."""
    band = isinstance(edges, tuple)
    sections = butter(2, edges, "band" if band else "low", fs=rate, output="sos")
    padding = min(30, len(values) - 1)
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=padding))


class TwoTakes:
    """Two takes, compared by the joints that they have in common."""

    def __init__(self, first: Take, second: Take) -> None:
        self._takes = (first, second)
        self._trunks = [_trunk(take) for take in self._takes]
        seen = ~np.isnan(first.positions[:, _spine(first.skeleton)]).all(axis=(1, 2))
        times = np.unique(first.time[seen])
        self._times = times[:: max(len(times) // _FRAMES, 1)]

    @cached_property
    def _moving(self) -> list[Spline]:
        return [_smoothed(take) for take in self._takes]

    def place(self, clock: Clock) -> tuple[Placement, float, float]:
        """Return the placement, its robust mean cost, and the distance left [m]."""
        seen = self._trunks[0].at(self._times)
        there = self._trunks[1].at(clock.at(self._times))
        found = placement(there, seen)
        away = np.linalg.norm(found.apply(there) - seen, axis=2)
        costs = np.fmin(np.log1p((away / SIGMA) ** 2), _MAX_COST)
        (apart,) = column_medians(away.reshape(-1, 1))
        return found, float(costs.mean()), float(apart)

    def refine(
        self, clock: Clock, placed: Placement, times: Array | None = None
    ) -> Clock:
        """Return the clock with the lag that explains the most movement."""
        # Movement, not positions: where sensors see joints depends on their view.
        times = self._times if times is None else times
        seen, there = self._moving
        moved = seen.at(times + _STEP) - seen.at(times)

        def errors(lag: float) -> Array:
            shifted = clock._replace(lag=lag)
            before, after = (there.at(shifted.at(times + t)) for t in (0.0, _STEP))
            apart = placed.rotate(after - before) - moved
            return np.asarray(np.sum(apart**2, axis=2))

        first, last = clock.lag - _AROUND, clock.lag + _AROUND
        known = ~np.isnan(errors(first) + errors(clock.lag) + errors(last))
        if known.sum() < _MIN_JOINTS:
            return clock
        found = minimize_scalar(
            lambda lag: np.log1p(np.nan_to_num(errors(lag))[known] / _MOVED**2).mean(),
            bounds=(first, last),
            method="bounded",
            options={"xatol": _PRECISION},
        )
        return clock._replace(lag=float(found.x))

    def find_drift(self, clock: Clock, placed: Placement) -> Clock:
        """Return the clock with its drift, if the lags of short windows show one.

        Windows come from ever longer spans around the middle, each searched with the
        drift found before: over an hour, a drifting clock is far off at both ends.
        """
        there = self._trunks[1].at(clock.at(self._times))
        times = self._times[~np.isnan(there).all(axis=(1, 2))]
        times = times[times <= times[-1:] - _WINDOW]
        stamps, span = self._trunks[0].time, _SPAN
        while len(times):
            near = times[np.abs(times - np.median(times)) <= 0.5 * span]
            length = np.ptp(near) + _WINDOW
            count = min(int(length / _WINDOW), _MAX_WINDOWS)
            if count < MIN_WINDOWS:
                break
            rows = []
            for begin in np.quantile(near, np.linspace(0.0, 1.0, count)):
                window = stamps[(stamps >= begin) & (stamps < begin + _WINDOW)]
                lag = self.refine(clock, placed, window).lag
                # At the end of the search range, the movements agree nowhere in it.
                if lag != clock.lag and abs(lag - clock.lag) < _AROUND - _EDGE:
                    rows.append((window.mean() - clock.start, lag))
            clock = with_drift(clock, np.array(rows)) or clock
            if len(near) == len(times):
                break
            span *= _LONGER
        return clock


def _spine(skeleton: Skeleton) -> list[int]:
    return [skeleton.root, skeleton.girdle, skeleton.index("Head")]


def _trunk(take: Take) -> Spline:
    skeleton = take.skeleton
    joints = [*_spine(skeleton), *skeleton.sides("Shoulder"), *skeleton.hips]
    return Spline(take.time, take.positions[:, joints])


def check_sensors(calibration: Sequence[Alignment], sensors: int) -> None:
    """Raise InputError if a calibration is for another number of sensors."""
    if calibration and len(calibration) != sensors - 1:
        raise InputError(
            f"the calibration covers {len(calibration) + 1} sensors, but {sensors} are "
            "given; give the takes of the same sensors in the same order"
        )
