"""Finds the lag and drift between a take and mocap of the same movement.

Distances between joints, which need no common frame of reference, are correlated on a
grid; then the lag is refined by minimizing the motion that a rigid transform leaves.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.merge.lag import Clock, Spline, correlations, with_drift
from kinefilter.pipeline.merge.rigid import SIGMA, placement

SHORTEST_FOR_DRIFT = 20.0  # s: least overlap for estimating drift. A guess.
_RATE = 60.0  # Hz, grid of the correlation
_WINDOW, _HOP = 5.0, 2.5  # s, windows in which the lag is found to estimate drift
_MARGIN = 0.25  # s by which a window's lag may differ from that of the recording
_LARGEST_DRIFT = 2e-3  # s per second
_LEAST_CORRELATION = 0.8  # of a window that counts
_PRECISION = 1e-4  # s
_FRAMES = 1000  # at most, to refine a lag


class Lag(NamedTuple):
    """A lag [s] and the correlation of the recordings there, -1 to 1."""

    seconds: float
    correlation: float


def distances(spline: Spline) -> Array:
    """Return distances between all joints [m], 1/_RATE s apart, (N, J (J - 1) / 2)."""
    count = int((spline.time[-1] - spline.time[0]) * _RATE) + 1
    positions = spline.at(spline.time[0] + np.arange(count) / _RATE)
    one, other = np.triu_indices(positions.shape[1], 1)
    return np.asarray(np.linalg.norm(positions[:, one] - positions[:, other], axis=2))


def best_lag(first: Array, second: Array, least: float) -> Lag | None:
    """Return the lag of the highest correlation, or None if the overlap is too short.

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
    return Lag(float(lags[best] + shift) / _RATE, float(scores[best]))


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


def find_drift(first: Array, second: Array, clock: Clock) -> Clock | None:
    """Return the clock with its drift, or None if the drift may be zero.

    The drift is the slope of the Theil-Sen line through the lags of windows of a few
    seconds. Distances [m] are as for ``best_lag``, and those in ``first`` begin with
    the first recording; ``clock`` has no drift yet.
    """
    width, hop = round(_WINDOW * _RATE), round(_HOP * _RATE)
    margin = round((_MARGIN + _LARGEST_DRIFT * len(first) / _RATE) * _RATE)
    rows = []
    for start in range(0, len(first) - width + 1, hop):
        expected = round((clock.lag + start / _RATE) * _RATE)
        begin = max(expected - margin, 0)
        part = second[begin : expected + width + margin]
        if len(part) < width:
            continue
        found = best_lag(first[start : start + width], part, 0.9 * _WINDOW)
        if found is not None and found.correlation > _LEAST_CORRELATION:
            lag = found.seconds + (begin - start) / _RATE
            rows.append(((start + width / 2) / _RATE, lag))
    return with_drift(clock, np.array(rows))
