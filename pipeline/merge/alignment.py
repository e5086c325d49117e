"""When and where a second sensor recorded what a first one did, from the motion itself.

Clocks first: heights of joints over each other are what sensors agree on best, and the
same from any side; how they go up and down tells the lag. Then one rigid transform lays
the second sensor's trunks onto the first's. How well joints move together after that
refines the lag, and how it changes tells the drift of the clocks.
"""

from __future__ import annotations

from functools import cached_property
from itertools import chain
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, find_peaks, sosfiltfilt
from scipy.spatial.transform import Rotation

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability import column_medians

from .lag import FEWEST_WINDOWS, Clock, Track, bridged, correlations, drifting
from .rigid import SIGMA, Placement, placement

_RATE = 20.0  # samples a second in which lags are looked for: joints move below 5 Hz
_BAND = (0.2, 5.0)  # Hz: slower is where people stand, faster is noise
_LARGE = 0.1  # m from which on movement counts hardly more
_COMMON = 2.0  # s that both recordings must have in common
_CANDIDATES = 6  # lags that are tried in space
_FRAMES = 1000  # are enough to place a sensor
_UNEXPLAINED = 0.30  # m: a frame that one sensor has alone costs as much as this
_MOST = np.log1p((_UNEXPLAINED / SIGMA) ** 2)
_WORST = 1.5
"""Cost of a fit above which two takes are not of the same movement. Chosen on p00 to
p08 of two-kinects: true pairs in which people move cost 1.4 or less there, takes of
different sessions 1.7 or more. A guess where less than half a take is in common."""
_LIKELY = 0.5  # of likeness; below it chance may have found the lag. Chosen there, too
_PATH = 0.5  # m that people have to go for a placement that is not of their body alone
_SMOOTH, _EVEN = 3.0, 60.0
"""Cutoff [Hz] and rate [1/s] of what lags are refined on. Between frames interpolation
takes noise off, which would draw the lag there."""
_STEP = 0.2  # s over which movement is compared
_MOVED = 0.01  # m that it may differ by
_AROUND = 0.12  # s that a first lag may be off
_PRECISION = 5e-4  # s
_FEWEST = 10  # joints of frames that tell a lag
_WINDOW, _MOST_WINDOWS = 8.0, 80  # s in which a drifting lag is told
_EDGE = 5e-3  # s from the end of the search
_SPAN, _LONGER = 600.0, 4.0
"""Length [s] of the first span that is searched for drift, and the factor by which it
grows. A clock that gains 0.2 ms a second is off by 0.06 s at the ends of the first."""

_LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")


class Alignment(NamedTuple):
    """A second sensor's clock and place, relative to those of the first."""

    clock: Clock
    """The second clock's time at times of the first."""
    placed: Placement
    """From the second sensor's frame to the first's."""
    apart: float
    """Median distance between the joints of the two trunks [m]."""
    likeness: float
    """How surely the movement tells the lag: Fisher's z of the correlation times the
    root of the seconds in common."""
    path: float
    """How far people went over the floor [m]."""
    common: float = 0.0
    """How much of the first take the second explains, in [0, 1]."""

    @property
    def clock_is_sure(self) -> bool:
        """Whether there is enough movement to tell the lag."""
        return self.likeness >= _LIKELY or self.place_is_sure

    @property
    def place_is_sure(self) -> bool:
        """Whether people went far enough to tell where the sensor is.

        Who stands is seen well enough to merge, but sensors see a body that stands
        turned by up to 30 degrees.
        """
        return self.path >= _PATH


HERE = Alignment(
    Clock(0.0, 0.0), Placement(Rotation.identity(), np.zeros(3)), 0.0, np.inf, np.inf
)
"""The first sensor, to itself."""


def align(first: Take, second: Take) -> Alignment:
    """Return when and where the second sensor recorded what the first did.

    Neither has to be calibrated, and their clocks may show anything. Of other skeletons
    the joints of the same name count.

    Raises:
        InputError: They are not of the same movement, or one take twice.
    """
    both = f"{first.source} and {second.source}"
    if np.array_equal(first.positions, second.positions, equal_nan=True):
        raise InputError(f"{both}: are the same take; give one of each sensor")
    lags, likeness = _likeness(_heights(first), _heights(second))
    peaks, _ = find_peaks(np.concatenate([[-np.inf], likeness, [-np.inf]]))
    peaks = peaks[np.isfinite(likeness[peaks - 1])] - 1
    if not len(peaks):
        raise InputError(
            f"{both}: at no lag do both see somebody for {_COMMON:g} s; give takes of "
            "the same time"
        )
    # A sensor behind the person has left and right exchanged.
    sides = [_Common(first, take) for take in (second, second.exchanged())]
    fits = []
    for k in peaks[np.argsort(-likeness[peaks])][:_CANDIDATES]:
        clock = Clock(float(first.time[0]), float(second.time[0] + lags[k]))
        for common in sides:
            placed, cost, _ = common.placed(clock)
            fits.append((cost, clock, placed, common, float(likeness[k])))
    cost, clock, placed, common, alike = min(fits, key=itemgetter(0))
    if cost > _WORST:
        raise InputError(
            f"{both}: do not show the same movement at any lag; give takes of the same "
            "people at the same time, by sensors that stand still"
        )
    clock = common.refined(clock, placed)
    placed, _, _ = common.placed(clock)
    clock = common.drifting(clock, placed)
    placed, _, apart = common.placed(clock)
    return Alignment(clock, placed, apart, alike, _path(first), 1.0 - cost / _MOST)


def _path(take: Take) -> float:
    """Return how far people went over the floor [m]."""
    places = take.positions[:, take.skeleton.root, ::2]
    places = places[~np.isnan(places).any(axis=1)]
    if not len(places):
        return 0.0
    low, high = np.percentile(places, (5.0, 95.0), axis=0)
    return float(np.hypot(*(high - low)))


def _heights(take: Take) -> Array:
    """Return how joints go up and down, in no unit, 1/_RATE s a row, (N, F).

    Pairs of limbs count by their mean height and by the difference between the two, so
    that exchanged sides change nothing; so does the speed over the floor.
    """
    times = np.arange(take.time[0], take.time[-1], 1.0 / _RATE)
    positions, skeleton = take.positions, take.skeleton
    height = Track(take.time, positions[..., 1:2]).at(times)[..., 0]
    root = Track(take.time, positions[:, [skeleton.root]]).at(times)[:, 0]
    height = height - root[:, 1:2]
    columns = [root[:, 1], height[:, skeleton.girdle]]
    columns.append(height[:, skeleton.index("Head")])
    for limb in _LIMBS:
        left, right = height[:, skeleton.sides(limb)].T
        columns += [0.5 * (left + right), np.abs(left - right)]
    values = np.stack(columns, axis=1)
    steps = np.gradient(_filled(root[:, ::2]), 1.0 / _RATE, axis=0)
    speed = np.linalg.norm(_passed(steps, 2.0), axis=1)
    speed[np.isnan(root[:, 0])] = np.nan
    found = _passed(_filled(values), _BAND) / _LARGE
    fast = _passed(_filled(speed[:, None]), 3.0) * 0.1 / _LARGE
    found = np.hstack([found, fast])
    return np.where(np.isnan(np.column_stack([values, speed])), np.nan, np.tanh(found))


def _smoothed(take: Take) -> Track:
    """Return tracked joints that tell the lag, without fast noise, at even times."""
    limbs = (take.skeleton.sides(limb) for limb in _LIMBS)
    joints = [*_middle(take.skeleton), *chain.from_iterable(limbs)]
    known = (take.state == State.TRACKED)[:, joints, None]
    track = Track(take.time, np.where(known, take.positions[:, joints], np.nan))
    times = np.arange(track.time[0], track.time[-1], 1.0 / _EVEN)
    flat = track.at(times).reshape(len(times), -1)
    even = _passed(bridged(times, flat), _SMOOTH, _EVEN)
    even[np.isnan(flat)] = np.nan
    return Track(times, even.reshape(len(times), len(joints), 3))


def _filled(values: Array) -> Array:
    """Return columns with medians in the place of what is missing."""
    return np.where(np.isnan(values), np.nan_to_num(column_medians(values)), values)


def _passed(
    values: Array, edges: float | tuple[float, float], rate: float = _RATE
) -> Array:
    """Return columns through a low pass, or a band pass between two edges [Hz]."""
    band = isinstance(edges, tuple)
    sections = butter(2, edges, "band" if band else "low", fs=rate, output="sos")
    padded = min(30, len(values) - 1)
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=padded))


def _likeness(first: Array, second: Array) -> tuple[Array, Array]:
    """Return lags [s] and how surely two recordings are of the same moments there.

    Fisher's z of the correlation times the root of the seconds in common, -inf where
    those are too few.
    """
    lags, correlation, common = correlations(first, second)
    seconds = common / _RATE
    found = np.arctanh(np.clip(correlation, -0.999, 0.999)) * np.sqrt(seconds)
    known = (seconds >= _COMMON) & ~np.isnan(found)
    return lags / _RATE, np.where(known, found, -np.inf)


class _Common:
    """Joints that two takes have in common."""

    def __init__(self, first: Take, second: Take) -> None:
        self._takes = (first, second)
        self._trunks = [_trunk(take) for take in self._takes]
        seen = ~np.isnan(first.positions[:, _middle(first.skeleton)]).all(axis=(1, 2))
        times = np.unique(first.time[seen])
        self._times = times[:: max(len(times) // _FRAMES, 1)]

    @cached_property
    def _moving(self) -> list[Track]:
        return [_smoothed(take) for take in self._takes]

    def placed(self, clock: Clock) -> tuple[Placement, float, float]:
        """Return where the second sensor is, what that costs, and the distance [m].

        The cost is that of a frame, robust to joints that are far apart.
        """
        seen = self._trunks[0].at(self._times)
        there = self._trunks[1].at(clock.at(self._times))
        found = placement(there, seen)
        away = np.linalg.norm(found.apply(there) - seen, axis=2)
        costs = np.fmin(np.log1p((away / SIGMA) ** 2), _MOST)
        (apart,) = column_medians(away.reshape(-1, 1))
        return found, float(costs.mean()), float(apart)

    def refined(
        self, clock: Clock, placed: Placement, times: Array | None = None
    ) -> Clock:
        """Return the clock with the lag that explains the most movement.

        Movement, not places: where sensors have joints differs with the view.
        """
        times = self._times if times is None else times
        seen, there = self._moving
        moved = seen.at(times + _STEP) - seen.at(times)

        def away(lag: float) -> Array:
            stamps = [clock._replace(lag=lag).at(times + late) for late in (0.0, _STEP)]
            before, after = map(there.at, stamps)
            apart = placed.turn_only(after - before) - moved
            return np.asarray(np.sum(apart**2, axis=2))

        first, last = clock.lag - _AROUND, clock.lag + _AROUND
        known = ~np.isnan(away(first) + away(clock.lag) + away(last))
        if known.sum() < _FEWEST:
            return clock
        found = minimize_scalar(
            lambda lag: np.log1p(np.nan_to_num(away(lag))[known] / _MOVED**2).mean(),
            bounds=(first, last),
            method="bounded",
            options={"xatol": _PRECISION},
        )
        return clock._replace(lag=float(found.x))

    def drifting(self, clock: Clock, placed: Placement) -> Clock:
        """Return the clock with its drift, where windows of some seconds tell one.

        The windows are first taken from some minutes around the middle of what both
        sensors see, then, with the drift found there, from longer spans: a clock that
        drifts is far off at both ends of an hour.
        """
        there = self._trunks[1].at(clock.at(self._times))
        times = self._times[~np.isnan(there).all(axis=(1, 2))]
        times = times[times <= times[-1:] - _WINDOW]
        stamps, span = self._trunks[0].time, _SPAN
        while len(times):
            near = times[np.abs(times - np.median(times)) <= 0.5 * span]
            length = np.ptp(near) + _WINDOW
            count = min(int(length / _WINDOW), _MOST_WINDOWS)
            if count < FEWEST_WINDOWS:
                break
            rows = []
            for begin in np.quantile(near, np.linspace(0.0, 1.0, count)):
                window = stamps[(stamps >= begin) & (stamps < begin + _WINDOW)]
                lag = self.refined(clock, placed, window).lag
                # At the end of the search the movement agrees nowhere in it.
                if lag != clock.lag and abs(lag - clock.lag) < _AROUND - _EDGE:
                    rows.append((window.mean() - clock.start, lag))
            clock = drifting(clock, np.array(rows)) or clock
            if len(near) == len(times):
                break
            span *= _LONGER
        return clock


def _middle(skeleton: Skeleton) -> list[int]:
    return [skeleton.root, skeleton.girdle, skeleton.index("Head")]


def _trunk(take: Take) -> Track:
    """Return the joints that tell where a sensor is."""
    bones = take.skeleton
    joints = [*_middle(bones), *bones.sides("Shoulder"), *bones.hips]
    return Track(take.time, take.positions[:, joints])
