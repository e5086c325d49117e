"""Lag and clock drift between two recordings of the same movement."""

from typing import NamedTuple, TypeVar

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar
from scipy.signal import fftconvolve
from scipy.stats import theilslopes

from kinefilter.characters.arrays import Array, Indices, chunks

from .rigid import SIGMA, placement

MIN_WINDOWS = 5  # that it takes to determine a drift
_LONGEST_GAP = 0.15  # s between samples to interpolate over
_CONFIDENCE = 0.99  # that there is a drift at all
_CELLS = 2_000_000  # products at all lags in memory at a time
_Time = TypeVar("_Time", float, Array)
_RATE = 60.0  # Hz, grid on which distances between joints are correlated
_PRECISION = 1e-4  # s
_FRAMES = 1000  # at most, to refine a lag


class Spline:
    """Positions [m] (T, J, 3) at nondecreasing stamps [s] (T,), interpolated."""

    def __init__(self, time: Array, positions: Array) -> None:
        self.time, first = np.unique(time, return_index=True)
        flat = positions[first].reshape(len(first), -1)
        self._known = ~np.isnan(flat)
        self._steady = np.diff(self.time) < _LONGEST_GAP
        filled, degree = interpolate_gaps(self.time, flat), min(3, len(self.time) - 1)
        self._spline = make_interp_spline(self.time, filled, k=degree)
        self._shape = positions.shape[1:]

    def at(self, times: Array) -> Array:
        """Return positions at some times [s], shape (N, J, 3).

        NaN outside of the recording, and between samples if one of them is missing.
        """
        last = len(self.time) - 1
        left = (np.searchsorted(self.time, times, "right") - 1).clip(0, last - 1)
        inside = (times >= self.time[0]) & (times <= self.time[-1])
        known = self._known[left] & self._known[left + 1]
        known &= (inside & self._steady[left])[:, None]
        found = np.where(known, self._spline(times), np.nan)
        return np.asarray(found.reshape(len(times), *self._shape))


class Clock(NamedTuple):
    """The second recording's clock as a function of the first's."""

    start: float  # time at which the first recording begins [s]
    lag: float  # what the second clock shows then [s]
    drift: float = 0.0  # seconds that the second clock gains in one of the first

    def at(self, time: _Time) -> _Time:
        """Return the second recording's times for those of the first [s]."""
        return self.lag + (1.0 + self.drift) * (time - self.start)

    def inverse(self, time: _Time) -> _Time:
        """Return the first recording's times for those of the second [s]."""
        return self.start + (time - self.lag) / (1.0 + self.drift)


def interpolate_gaps(time: Array, values: Array) -> Array:
    """Return columns (T, C) with NaN interpolated linearly; 0 if all are NaN."""
    found = np.zeros_like(values)
    for k, column in enumerate(values.T):
        known = ~np.isnan(column)
        if known.any():
            found[:, k] = np.interp(time, time[known], column[known])
    return found


def correlations(first: Array, second: Array) -> tuple[Indices, Array, Array]:
    """Return lags in samples, the correlation at each and the samples in common.

    Series (N, F) and (M, F), with NaN where unknown, are correlated column by column,
    each about its mean over the samples in common, and pooled. A lag is how far into
    the second series the first begins. The correlation is NaN if nothing varies.
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
    scale[scale <= 1e-9] = np.nan
    return lags, sums[0] / scale, common


def _centered(values: Array) -> tuple[Array, Array]:
    """Return columns minus their means, 0 where unknown, and 1.0 where known."""
    known = ~np.isnan(values)
    centered = values - np.nansum(values, axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known, centered, 0.0), known.astype(float)


def with_drift(clock: Clock, rows: Array) -> Clock | None:
    """Return a clock with the drift that lags show, None if it is not significant.

    Fits Theil and Sen's line to rows (N, 2): seconds since the clock's start, and the
    lag [s] that would be right then.
    """
    if len(rows) < MIN_WINDOWS:
        return None
    slope, lag, low, high = theilslopes(rows[:, 1], rows[:, 0], _CONFIDENCE)
    if low <= 0.0 <= high:
        return None
    return clock._replace(lag=float(lag), drift=clock.drift + float(slope))


def distances(spline: Spline) -> Array:
    """Return distances between all joints [m], 1/_RATE s apart, (N, J (J - 1) / 2)."""
    count = int((spline.time[-1] - spline.time[0]) * _RATE) + 1
    positions = spline.at(spline.time[0] + np.arange(count) / _RATE)
    one, other = np.triu_indices(positions.shape[1], 1)
    return np.asarray(np.linalg.norm(positions[:, one] - positions[:, other], axis=2))


def best_lag(first: Array, second: Array, least: float) -> float | None:
    """Return the lag [s] of highest correlation, or None if the overlap is too short.

    The lag is the time in the second recording at which the first one begins. Distances
    [m] are 1/_RATE s apart, NaN where unknown, shapes (N, F) and (M, F); they overlap
    by ``least`` [s] or more.
    """
    lags, correlation, common = correlations(first, second)
    valid = (common >= least * _RATE) & ~np.isnan(correlation)
    if not valid.any():
        return None
    scores = np.where(valid, correlation, -np.inf)
    best, shift = int(np.argmax(scores)), 0.0
    around = scores[max(best - 1, 0) : best + 2]
    if len(around) == 3 and np.isfinite(around).all():
        before, peak, after = around
        curvature = before - 2.0 * peak + after  # of the parabola through the three
        shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    return float(lags[best] + shift) / _RATE


def refine_lag(take: Spline, mocap: Spline, clock: Clock) -> Clock:
    """Return the clock with the lag that a rigid transform explains best."""
    times = take.time[:: max(len(take.time) // _FRAMES, 1)]
    seen = take.at(times)

    def cost(lag: float) -> float:
        there = mocap.at(clock._replace(lag=lag).at(times))
        away = placement(there, seen).apply(there) - seen
        varying = np.sum((away - np.nanmedian(away, axis=0)) ** 2, axis=2)
        return float(np.nanmean(np.log1p(varying / SIGMA**2)))

    bounds = (clock.lag - 2.0 / _RATE, clock.lag + 2.0 / _RATE)
    best = minimize_scalar(cost, bounds=bounds, options={"xatol": _PRECISION})
    return clock._replace(lag=float(best.x))
