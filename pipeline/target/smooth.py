"""Zero-lag smoothing of a whole take.

Whittaker's smoother minimizes sum of w |z - y|^2 + lambda sum of |third difference of
z|^2. It has no lag, keeps quadratic motion exactly, and bridges values of little weight
(Eilers 2003, A perfect smoother, Anal. Chem. 75).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpbsv
from scipy.ndimage import median_filter, uniform_filter1d

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Indices

_THIRD = (-1.0, 3.0, -3.0, 1.0)
_ORDER = 3
# For smooth_by_speed: Hz of a joint at rest, and Hz per m/s, of joints in the room and
# of those that the body carries. Chosen as RESULTS says under "Smoothing".
_IN_ROOM, _CARRIED = (0.7, 2.5), (1.2, 2.5)
_TRAVEL_CUTOFF = 0.5  # Hz, of where the body goes as a whole
_FIRST_CUTOFF = 3.0  # Hz, to estimate the speed
_PASSES = 2  # estimates of the speed
_SPEED_TIME = 7 / 30  # s over which speed is averaged
# Of outliers, chosen as RESULTS says under "Smoothing".
_BRIEF = 1 / 6  # s of the running median, twice as long as what it ignores
_USUAL_TIME = 1.0  # s around a frame that show how far off a joint usually is
_MOST_FRAMES = 121  # of a running median: a second at the rate of fast mocap
_USUAL, _NEAR = 2.0, 0.05  # times the usual distance, and m, that halve a weight
# To find small quick movement, which by its speed alone would be taken for trembling;
# chosen on simulated takes.
_QUICK = 0.2  # of the frame rate: anything faster is taken for noise
_MOVES = (4.0, 8.0)  # times the noise, from which it may be, and is, movement
_LEAST_NOISE = 0.003  # m, of a good sensor
_MOVE_TIME = 0.5  # s over which both are averaged
_NYQUIST = 0.49  # of the frame rate: highest cutoff with a stiffness that is not tiny
_LONGEST_GAP = 30  # missing frames with which a gap is bridged; a longer one shrinks


def smooth(time: Array, values: Array, weights: Array, *, cutoff: float) -> Array:
    """Return smoothed values (T, J, C).

    Time stamps [s], shape (T,), increase strictly; weights are the confidence in each
    value in (0, 1], shape (T, J). ``cutoff`` is the frequency [Hz] at which half of the
    amplitude is left at confidence 1; confidence w moves it by a factor of w^(1/6).
    """
    if len(time) <= _ORDER or cutoff >= 0.5 / np.median(np.diff(time)):
        return values.copy()
    grid, step = _grid(time)
    stiffness = np.full(grid[-1] + 1 - _ORDER, _stiffness(cutoff, step))
    bands, smoothed = penalty(stiffness, _THIRD), np.empty_like(values)
    for j in range(values.shape[1]):
        smoothed[:, j] = _solve(bands, grid, values[:, j], weights[:, j])[grid]
    return smoothed


def travel_of(time: Array, joints: Array, skeleton: Skeleton) -> Array:
    """Return the paths [m] on which the body carries its joints (T, J, 3).

    That is where the hips go. They themselves, which rise and fall with each step, and
    feet, which stand in the room, are not carried.
    """
    hips = joints[:, skeleton.hips].mean(axis=1, keepdims=True)
    path = smooth(time, hips, np.ones(hips.shape[:2]), cutoff=_TRAVEL_CUTOFF)
    carried = ~np.isin(skeleton.kinds, ("Hip", "Ankle", "Foot"))
    carried[skeleton.root] = False
    return np.where(carried[:, None], path, 0.0)


def weights_of_outliers(time: Array, values: Array) -> Array:
    """Return weights (T, J) of joint paths [m] (T, J, 3), low for brief outliers.

    A joint's distance from the running median is compared with its usual distance
    around that time, which has weight 1, as in a Hampel filter (Pearson 2002, IEEE
    Trans. Control Syst. Technol. 10); the weights are those of a Cauchy distribution.
    """
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    brief, around = (
        min(2 * round(0.5 * seconds / step) + 1, _MOST_FRAMES)
        for seconds in (_BRIEF, _USUAL_TIME)
    )
    medians = median_filter(values, (brief, 1, 1), mode="nearest")
    off = np.linalg.norm(values - medians, axis=2)
    usual = median_filter(off, (around, 1), mode="nearest")
    squared = np.maximum(_USUAL * usual, _NEAR) ** 2
    return np.asarray((squared + usual**2) / (squared + np.maximum(off, usual) ** 2))


def smooth_by_speed(
    time: Array,
    values: Array,
    weights: Array,
    *,
    cutoff: float,
    travel: Array | None = None,
) -> Array:
    """Return joint paths [m] (T, J, 3), smoothed more strongly where a joint is slow.

    Trembling of a joint at rest is noise, but quick changes of a moving one may be
    movement. So the cutoff grows with the speed of the smoothed path, as in the 1 euro
    filter (Casiez, Roussel & Vogel 2012, CHI), but without its lag. It is the highest,
    ``cutoff`` [Hz], where that would remove far more than noise, as when hands clap or
    shake. Speed counts relative to ``travel`` [m], the path on which the body carries
    each joint (T, J, 3). Other arguments are as in ``smooth``.
    """
    if len(time) <= _ORDER:
        return values.copy()
    grid, step = _grid(time)
    highest = np.full(grid[-1] + 1 - _ORDER, min(cutoff, _NYQUIST / step))
    frames, carried, smoothed = np.arange(grid[-1] + 1), None, np.empty_like(values)
    for j in range(values.shape[1]):
        if travel is not None:
            paths = [np.interp(frames, grid, path) for path in travel[:, j].T]
            carried = np.diff(paths).T
        joint = grid, values[:, j], weights[:, j]
        smoothed[:, j] = _by_speed(step, highest, *joint, carried)
    return smoothed


def _by_speed(
    step: float,
    highest: Array,
    grid: Indices,
    values: Array,
    weights: Array,
    carried: Array | None,
) -> Array:
    """Return the smoothed path of one joint, shape (T, 3)."""

    def smoothed(rates: Array) -> Array:  # cutoffs [Hz], one per third difference
        bands = penalty(_stiffness(rates, step), _THIRD)
        return _solve(bands, grid, values, weights)

    slowest, rise = _IN_ROOM if carried is None or not carried.any() else _CARRIED
    rates = np.minimum(_FIRST_CUTOFF, highest)
    for _ in range(_PASSES):
        moves = np.diff(smoothed(rates), axis=0)
        moves = moves if carried is None else moves - carried
        moved = _root_mean_square(moves, _SPEED_TIME / step)
        rates = np.minimum(slowest + rise * moved[1:-1] / step, highest)
    quick = smoothed(np.minimum(_QUICK / step, highest))
    noise = np.zeros_like(quick)
    noise[grid] = values - quick[grid]
    lost = quick - smoothed(rates)
    lost, noise = (_root_mean_square(x, _MOVE_TIME / step) for x in (lost, noise))
    low, high = _MOVES
    ratio = lost / np.maximum(noise, _LEAST_NOISE)
    share = np.clip((ratio - low) / (high - low), 0.0, 1.0)
    # The mean of the middle two of the four frames of a third difference.
    rates = rates + 0.5 * (share[1:-2] + share[2:-1]) * (highest - rates)
    return smoothed(rates)[grid]


def _root_mean_square(vectors: Array, frames: float) -> Array:
    """Return the moving root mean square length over about that many frames, (T,)."""
    odd = 2 * round(0.5 * (frames - 1.0)) + 1  # an even number would shift time
    mean = uniform_filter1d(np.sum(vectors**2, axis=1), max(odd, 1))
    # The filter keeps a running sum, which rounding can make negative.
    return np.sqrt(np.maximum(mean, 0.0))


def _grid(time: Array) -> tuple[Indices, float]:
    """Return the indices of frames on an even grid, all different, and its step [s]."""
    steps = np.diff(time)
    step = float(np.median(steps))
    frames = np.clip(np.round(steps / step), 1, _LONGEST_GAP)
    return np.concatenate([[0], np.cumsum(frames.astype(np.intp))]), step


def _stiffness(cutoff: Any, step: float) -> Any:
    # The share of a sine that is left is 1 / (1 + lambda |2 sin(w/2)|^6): here a half.
    return (2.0 * np.sin(np.pi * cutoff * step)) ** (-2 * _ORDER)


def _solve(bands: Array, grid: Indices, values: Array, weights: Array) -> Array:
    """Return the smoothed path of a joint, given the penalty's bands, (length, C)."""
    system, right = bands.copy(), np.zeros((bands.shape[1], values.shape[1]))
    system[0, grid] += weights
    right[grid] = weights[:, None] * values
    # LAPACK directly: scipy's checks take longer.
    return np.asarray(dpbsv(system, right, lower=1)[1])


def penalty(stiffness: Array, difference: Sequence[float]) -> Array:
    """Return the lower bands of D'LD, shape (order + 1, rows + order).

    D takes differences with the given coefficients; L has their stiffness (rows,).
    """
    order, rows = len(difference) - 1, len(stiffness)
    bands = np.zeros((order + 1, rows + order))
    for a in range(order + 1):
        for b in range(a + 1):
            bands[a - b, b : b + rows] += difference[a] * difference[b] * stiffness
    return bands
