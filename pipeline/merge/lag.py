"""When two recordings of one movement show the same moment: lag, and clock drift.

Distances between joints are the same in any frame, so they tell the lag before anything
is known of where the recordings' axes lie. Their correlation finds it on a grid; what
is left of the joints' movement after one rigid transform refines it.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import fftconvolve
from scipy.stats import theilslopes

from kinefilter.characters.arrays import Array, Indices, chunks

from .rigid import SIGMA, placement

RATE = 60.0
"""Samples a second in which lags are looked for first."""
SHORTEST_FOR_DRIFT = 20.0
"""Seconds that both recordings need in common to tell a drift. A guess."""

FEWEST_WINDOWS = 5
"""Windows of some seconds that it takes to tell a drift."""

_LONGEST_GAP = 0.15  # s that are bridged between samples
_WINDOW, _HOP = 5.0, 2.5  # s in which a drifting lag is told
_SLOWEST = 0.25  # s that it may be off in a window
_FASTEST = 2e-3  # s a second of drift at most
_FOLLOWED = 0.8  # correlation of a window that tells a lag
_CONFIDENCE = 0.99  # that there is a drift at all
_PRECISION = 1e-4  # s
_CELLS = 2_000_000  # of distances at all lags, at once
_FRAMES = 1000  # are enough to refine a lag


class Track:
    """Positions at any time, NaN where there are none."""

    def __init__(self, time: Array, positions: Array) -> None:
        """Take stamps [s] (T,), which never decrease, and positions [m] (T, J, 3)."""
        self.time, first = np.unique(time, return_index=True)
        flat = positions[first].reshape(len(first), -1)
        self._known = ~np.isnan(flat)
        self._steady = np.diff(self.time) < _LONGEST_GAP
        filled = np.zeros_like(flat)
        for k, known in enumerate(self._known.T):
            if known.any():
                filled[:, k] = np.interp(self.time, self.time[known], flat[known, k])
        self._spline = CubicSpline(self.time, filled)
        self._shape = positions.shape[1:]

    def at(self, times: Array) -> Array:
        """Return positions at some times [s], shape (N, J, 3).

        NaN outside of the recording, and between samples of which one is missing.
        """
        last = len(self.time) - 1
        left = (np.searchsorted(self.time, times, "right") - 1).clip(0, last - 1)
        inside = (times >= self.time[0]) & (times <= self.time[-1])
        whole = self._known[left] & self._known[left + 1]
        whole &= (inside & self._steady[left])[:, None]
        found = np.where(whole, self._spline(times), np.nan)
        return np.asarray(found.reshape(len(times), *self._shape))

    def grid(self) -> Array:
        """Return even times of the whole recording, ``RATE`` a second [s], (N,)."""
        count = int((self.time[-1] - self.time[0]) * RATE) + 1
        return np.asarray(self.time[0] + np.arange(count) / RATE)


class Clock(NamedTuple):
    """What the second recording's clock shows at a time of the first."""

    start: float
    """Time at which the first recording begins [s]."""
    lag: float
    """What the second clock shows then [s]."""
    drift: float = 0.0
    """Seconds that the second clock gains in one of the first."""

    def at(self, time: Array) -> Array:
        """Return the second recording's times for those of the first [s]."""
        return self.lag + (1.0 + self.drift) * (time - self.start)

    def undone(self, time: Array) -> Array:
        """Return the first recording's times for those of the second [s]."""
        return self.start + (time - self.lag) / (1.0 + self.drift)


class Lag(NamedTuple):
    """A lag [s] and how well the recordings correlate there, -1 to 1."""

    seconds: float
    correlation: float


def distances(positions: Array) -> Array:
    """Return all distances between joints, shape (T, J (J - 1) / 2)."""
    one, other = np.array(list(combinations(range(positions.shape[1]), 2))).T
    apart = positions[:, one] - positions[:, other]
    return np.asarray(np.linalg.norm(apart, axis=2))


def correlated(first: Array, second: Array, least: float) -> Lag | None:
    """Return at which lag two series of distances correlate best; None without any.

    Args:
        first: Distances [m], a row each 1/RATE s, NaN where unknown, (N, F).
        second: Those of the other recording, (M, F).
        least: Seconds that they must have in common.

    The lag is how far into the second the first begins.
    """
    lags, correlation, common = correlations(first, second)
    fit = (common >= least * RATE) & ~np.isnan(correlation)
    if not fit.any():
        return None
    found = np.where(fit, correlation, -np.inf)
    best = int(np.argmax(found))
    shift = 0.0
    if 0 < best < len(lags) - 1 and np.isfinite(found[best - 1 : best + 2]).all():
        before, at, after = found[best - 1 : best + 2]
        bend = before - 2.0 * at + after  # of the parabola through the three
        shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return Lag(float(lags[best] + shift) / RATE, float(found[best]))


def correlations(first: Array, second: Array) -> tuple[Indices, Array, Array]:
    """Return lags in samples, the correlation there and the samples in common.

    Series (N, F) and (M, F) are correlated column by column, each about its mean over
    what is in common, and pooled; NaN are unknown. A lag is how far into the second the
    first begins. The correlation is NaN where nothing varies.
    """
    lags = np.arange(1 - len(first), len(second))
    sums, common = np.zeros((3, len(lags))), np.zeros(len(lags))
    for some in chunks(first.shape[1], max(_CELLS // len(lags), 1)):
        x, u = _centered(first[::-1, some])
        y, v = _centered(second[:, some])
        count = np.maximum(np.round(fftconvolve(v, u, axes=0)), 1e-9)
        sum_x, sum_y = fftconvolve(v, x, axes=0), fftconvolve(y, u, axes=0)
        products = [
            fftconvolve(y, x, axes=0) - sum_x * sum_y / count,
            fftconvolve(v, x * x, axes=0) - sum_x**2 / count,
            fftconvolve(y * y, u, axes=0) - sum_y**2 / count,
        ]
        sums += np.sum(products, axis=2)
        common = np.maximum(common, count.max(axis=1))
    scale = np.sqrt(np.maximum(sums[1], 0.0) * np.maximum(sums[2], 0.0))
    varies = scale > 1e-9
    return (
        lags,
        np.where(varies, sums[0] / np.where(varies, scale, 1.0), np.nan),
        common,
    )


def _centered(values: Array) -> tuple[Array, Array]:
    """Return columns without their means, 0 where unknown, and 1 where known."""
    known = ~np.isnan(values)
    centered = values - np.nansum(values, axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known, centered, 0.0), known.astype(float)


def refined(take: Track, mocap: Track, clock: Clock) -> Clock:
    """Return the clock with the lag at which the least movement is left unexplained."""
    times = take.time[:: max(len(take.time) // _FRAMES, 1)]
    seen = take.at(times)

    def left_over(lag: float) -> float:
        there = mocap.at(clock._replace(lag=lag).at(times))
        away = placement(there, seen).apply(there) - seen
        varying = np.sum((away - np.nanmedian(away, axis=0)) ** 2, axis=2)
        return float(np.nanmean(np.log1p(varying / SIGMA**2)))

    around = (clock.lag - 2.0 / RATE, clock.lag + 2.0 / RATE)
    found = minimize_scalar(
        left_over, bounds=around, method="bounded", options={"xatol": _PRECISION}
    )
    return clock._replace(lag=float(found.x))


def find_drift(first: Array, second: Array, clock: Clock) -> Clock | None:
    """Return the clock with its drift, or None where the recordings tell none.

    The lag is told in windows of some seconds; Theil and Sen's line through them has
    the drift as its slope, if it is surely not zero.

    Args:
        first: Distances [m] from the first recording's begin, as of ``correlated``.
        second: Those of the other.
        clock: Without drift.
    """
    width, hop = round(_WINDOW * RATE), round(_HOP * RATE)
    seconds = len(first) / RATE
    most = _SLOWEST + _FASTEST * seconds
    rows = []
    for start in range(0, len(first) - width + 1, hop):
        expected = round((clock.lag + start / RATE) * RATE)
        margin = round(most * RATE)
        begin = max(expected - margin, 0)
        part = second[begin : expected + width + margin]
        if len(part) < width:
            continue
        found = correlated(first[start : start + width], part, 0.9 * _WINDOW)
        if found is not None and found.correlation > _FOLLOWED:
            middle = (start + width / 2) / RATE
            lag = found.seconds + (begin - start) / RATE
            rows.append((middle, lag))
    return drifting(clock, np.array(rows))


def drifting(clock: Clock, rows: Array) -> Clock | None:
    """Return a clock with the drift that lags tell, None where they surely tell none.

    Theil and Sen's line through rows (N, 2) of seconds from the clock's start and the
    lag [s] then.
    """
    if len(rows) < FEWEST_WINDOWS:
        return None
    slope, lag, low, high = theilslopes(rows[:, 1], rows[:, 0], _CONFIDENCE)
    if low <= 0.0 <= high:
        return None
    return clock._replace(lag=float(lag), drift=float(slope))
