"""When a take and mocap of the same movement show the same moment.

Distances between joints are the same in any frame, so they tell the lag before anything
is known of where the recordings' axes lie. Their correlation finds it on a grid; what
is left of the joints' movement after one rigid transform refines it.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.merge.lag import Clock, Track, correlations, drifting
from kinefilter.pipeline.merge.rigid import SIGMA, placement

_RATE = 60.0  # samples a second in which lags are looked for first
SHORTEST_FOR_DRIFT = 20.0
"""Seconds that both recordings need in common to tell a drift. A guess."""
_WINDOW, _HOP = 5.0, 2.5  # s in which a drifting lag is told
_SLOWEST = 0.25  # s that it may be off in a window
_FASTEST = 2e-3  # s a second of drift at most
_FOLLOWED = 0.8  # correlation of a window that tells a lag
_PRECISION = 1e-4  # s
_FRAMES = 1000  # are enough to refine a lag


class Lag(NamedTuple):
    """A lag [s] and how well the recordings correlate there, -1 to 1."""

    seconds: float
    correlation: float


def distances(track: Track) -> Array:
    """Return all distances between joints [m], 1/_RATE s a row, (N, J (J - 1) / 2)."""
    count = int((track.time[-1] - track.time[0]) * _RATE) + 1
    positions = track.at(track.time[0] + np.arange(count) / _RATE)
    one, other = np.array(list(combinations(range(positions.shape[1]), 2))).T
    apart = positions[:, one] - positions[:, other]
    return np.asarray(np.linalg.norm(apart, axis=2))


def correlated(first: Array, second: Array, least: float) -> Lag | None:
    """Return at which lag two series of distances correlate best; None without any.

    Args:
        first: Distances [m], a row each 1/_RATE s, NaN where unknown, (N, F).
        second: Those of the other recording, (M, F).
        least: Seconds that they must have in common.

    The lag is how far into the second the first begins.
    """
    lags, correlation, common = correlations(first, second)
    fit = (common >= least * _RATE) & ~np.isnan(correlation)
    if not fit.any():
        return None
    found = np.where(fit, correlation, -np.inf)
    best = int(np.argmax(found))
    shift = 0.0
    if 0 < best < len(lags) - 1 and np.isfinite(found[best - 1 : best + 2]).all():
        before, at, after = found[best - 1 : best + 2]
        bend = before - 2.0 * at + after  # of the parabola through the three
        shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return Lag(float(lags[best] + shift) / _RATE, float(found[best]))


def refined(take: Track, mocap: Track, clock: Clock) -> Clock:
    """Return the clock with the lag at which the least movement is left unexplained."""
    times = take.time[:: max(len(take.time) // _FRAMES, 1)]
    seen = take.at(times)

    def left_over(lag: float) -> float:
        there = mocap.at(clock._replace(lag=lag).at(times))
        away = placement(there, seen).apply(there) - seen
        varying = np.sum((away - np.nanmedian(away, axis=0)) ** 2, axis=2)
        return float(np.nanmean(np.log1p(varying / SIGMA**2)))

    around = (clock.lag - 2.0 / _RATE, clock.lag + 2.0 / _RATE)
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
    width, hop = round(_WINDOW * _RATE), round(_HOP * _RATE)
    seconds = len(first) / _RATE
    most = _SLOWEST + _FASTEST * seconds
    rows = []
    for start in range(0, len(first) - width + 1, hop):
        expected = round((clock.lag + start / _RATE) * _RATE)
        margin = round(most * _RATE)
        begin = max(expected - margin, 0)
        part = second[begin : expected + width + margin]
        if len(part) < width:
            continue
        found = correlated(first[start : start + width], part, 0.9 * _WINDOW)
        if found is not None and found.correlation > _FOLLOWED:
            middle = (start + width / 2) / _RATE
            lag = found.seconds + (begin - start) / _RATE
            rows.append((middle, lag))
    return drifting(clock, np.array(rows))
