"""Zero-lag smoothing of a whole take.

Whittaker's smoother: it minimizes sum of w |z - y|^2 + lambda sum of |third
difference of z|^2, so it has no lag, keeps quadratic motion exactly, and bridges what
has little weight (Eilers 2003, A perfect smoother, Anal. Chem. 75).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import solveh_banded
from scipy.ndimage import uniform_filter1d

from kinefilter.characters.arrays import Array, Indices

_THIRD = (-1.0, 3.0, -3.0, 1.0)
_ORDER = 3
# Of smooth_by_speed, chosen on simulated takes and three of six recorded people.
_SLOWEST_CUTOFF = 0.7  # Hz, of a joint at rest
_PER_SPEED = 2.5  # Hz per m/s
_FIRST_CUTOFF = 3.0  # Hz, to estimate the speed
_PASSES = 2  # estimates of the speed
_SPEED_TIME = 7 / 30  # s that a speed is averaged over
# Of small quick movement, which by its speed alone would pass for trembling; chosen on
# simulated takes.
_QUICK = 0.2  # of the frame rate: what is faster is taken for noise
_MOVES = (4.0, 8.0)  # times the noise: from where it is perhaps, and surely, movement
_LEAST_NOISE = 0.003  # m, of a good sensor
_MOVE_TIME = 0.5  # s that both are averaged over
_NYQUIST = 0.49  # of the frame rate: where the stiffness is not nothing yet
_LONGEST_GAP = 30  # missing frames that a gap is bridged with; a longer one shrinks


def smooth(time: Array, values: Array, weights: Array, *, cutoff: float) -> Array:
    """Return smoothed values.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        values: What to smooth, shape (T, J, C).
        weights: Confidence in each value, in [0, 1], over 0, shape (T, J).
        cutoff: Frequency [Hz] at which half of the amplitude of a fully trusted value
            is left; confidence w moves it by a factor of w^(1/6).
    """
    if len(time) <= _ORDER:
        return values.copy()
    grid, step = _grid(time), float(np.median(np.diff(time)))
    if cutoff >= 0.5 / step:
        return values.copy()
    stiffness = np.full(grid[-1] + 1 - _ORDER, _stiffness(cutoff, step))
    smoothed = np.empty_like(values)
    for j in range(values.shape[1]):
        found = _solve(stiffness, grid, values[:, j], weights[:, j])
        smoothed[:, j] = found[grid]
    return smoothed


def smooth_by_speed(
    time: Array, values: Array, weights: Array, *, cutoff: float
) -> Array:
    """Return joint paths, the smoother the slower a joint is.

    What trembles while a joint rests is noise, what is quick while it moves may be
    movement: the cutoff grows with the speed of what is left, as in the 1 euro filter
    (Casiez, Roussel & Vogel 2012, CHI), but without its lag. Where that would take away
    far more than the sensor trembles, hands clap or shake: there the cutoff is the
    highest.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        values: Positions [m], shape (T, J, 3).
        weights: Confidence in each joint, in [0, 1], over 0, shape (T, J).
        cutoff: The highest frequency [Hz] that is kept, where a joint is fast.
    """
    if len(time) <= _ORDER:
        return values.copy()
    grid, step = _grid(time), float(np.median(np.diff(time)))
    highest = np.full(grid[-1] + 1 - _ORDER, min(cutoff, _NYQUIST / step))
    smoothed = np.empty_like(values)
    for j in range(values.shape[1]):
        smoothed[:, j] = _by_speed(step, highest, grid, values[:, j], weights[:, j])
    return smoothed


def _by_speed(
    step: float, highest: Array, grid: Indices, values: Array, weights: Array
) -> Array:
    """Return the smoothed path of one joint, shape (T, 3)."""

    def at(rates: Array) -> Array:
        """Return the path for a cutoff [Hz] at each third difference."""
        return _solve(_stiffness(rates, step), grid, values, weights)

    rates = np.minimum(_FIRST_CUTOFF, highest)
    for _ in range(_PASSES):
        moved = _root_mean_square(np.diff(at(rates), axis=0), _SPEED_TIME / step)
        rates = np.minimum(_SLOWEST_CUTOFF + _PER_SPEED * moved[1:-1] / step, highest)
    quick = at(np.minimum(_QUICK / step, highest))
    noise = np.zeros_like(quick)
    noise[grid] = values - quick[grid]
    lost = quick - at(rates)
    lost, noise = (_root_mean_square(x, _MOVE_TIME / step) for x in (lost, noise))
    perhaps, surely = _MOVES
    ratio = lost / np.maximum(noise, _LEAST_NOISE)
    share = np.clip((ratio - perhaps) / (surely - perhaps), 0.0, 1.0)
    # Of the two frames in the middle of the difference's four.
    rates = rates + 0.5 * (share[1:-2] + share[2:-1]) * (highest - rates)
    return at(rates)[grid]


def _root_mean_square(vectors: Array, frames: float) -> Array:
    """Return the moving root mean square length over about as many frames, (T,)."""
    odd = 2 * round(0.5 * (frames - 1.0)) + 1  # an even number would shift time
    mean = uniform_filter1d(np.sum(vectors**2, axis=1), max(odd, 1))
    # The filter keeps a running sum, which rounding can make negative.
    return np.asarray(np.sqrt(np.maximum(mean, 0.0)))


def _grid(time: Array) -> Indices:
    """Return the place of every frame among evenly spaced ones, at least one apart."""
    steps = np.diff(time)
    frames = np.clip(np.round(steps / np.median(steps)), 1, _LONGEST_GAP)
    return np.concatenate([[0], np.cumsum(frames.astype(np.intp))])


def _stiffness(cutoff: Any, step: float) -> Any:
    """Return lambda at which half of a sine of the cutoff frequency is left.

    A sine keeps 1 / (1 + lambda |2 sin(w/2)|^6).
    """
    return (2.0 * np.sin(np.pi * cutoff * step)) ** (-2 * _ORDER)


def _solve(stiffness: Array, grid: Indices, values: Array, weights: Array) -> Array:
    """Return the smoothed path of one joint on the even grid, shape (length, C)."""
    length = len(stiffness) + _ORDER
    system = penalty(stiffness, _THIRD)
    system[0, grid] += weights
    right = np.zeros((length, values.shape[1]))
    right[grid] = weights[:, None] * values
    return np.asarray(solveh_banded(system, right, lower=True))


def penalty(stiffness: Array, difference: Sequence[float]) -> Array:
    """Return the lower bands of D'LD, shape (order + 1, rows + order).

    D takes differences of some order, each of which has its stiffness, shape (rows,).
    """
    order, rows = len(difference) - 1, len(stiffness)
    bands = np.zeros((order + 1, rows + order))
    for a in range(order + 1):
        for b in range(a + 1):
            bands[a - b, b : b + rows] += difference[a] * difference[b] * stiffness
    return bands
