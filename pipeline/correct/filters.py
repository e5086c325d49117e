"""Smoothing filters, which know noise, and nothing of bodies: baselines.

The live character smooths its target with one of them, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

from .hold import Hold
from .interface import Correction, Observation, ObservedTake

_LEAST_STEP = 1e-3  # s: a repeated time stamp is no reason to divide by zero


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


class Butterworth:
    """Low-pass filter over the frames, forward and backward, so without lag.

    Gaps are bridged first. A take shorter than the filter's padding, or with a frame
    rate that cannot hold the cutoff, is bridged only.

    Args:
        cutoff: Frequency [Hz] at which half of the amplitude is left: each of the two
            passes leaves 1 / sqrt(2).
        order: Order of one pass.
    """

    def __init__(self, cutoff: float = 6.0, order: int = 2) -> None:
        self.cutoff = cutoff
        self.order = order

    def correct(self, take: ObservedTake) -> Array:
        """Return filtered positions [m], NaN for joints never seen, (T, J, 3)."""
        bridged, rate = bridge_gaps(take.time, take.positions), _rate(take.time)
        padding = 3 * (self.order + 1)
        if len(bridged) <= padding or 2.0 * self.cutoff >= rate:
            return bridged
        sections = butter(self.order, self.cutoff, fs=rate, output="sos")
        smooth = sosfiltfilt(sections, np.nan_to_num(bridged), 0, padlen=padding)
        return np.where(np.isnan(bridged), np.nan, smooth)


class SavitzkyGolay:
    """Least-squares polynomials over a sliding window, which have no lag.

    Gaps are bridged first. A take shorter than the window, or with so low a frame rate
    that a polynomial fits the window's frames exactly, is bridged only.

    Args:
        window_seconds: Length of the window [s], rounded to an odd number of frames.
        order: Order of the polynomials: motion of this order passes unchanged.
    """

    def __init__(self, window_seconds: float = 0.3, order: int = 3) -> None:
        self.window_seconds = window_seconds
        self.order = order

    def correct(self, take: ObservedTake) -> Array:
        """Return filtered positions [m], NaN for joints never seen, (T, J, 3)."""
        bridged = bridge_gaps(take.time, take.positions)
        window = 2 * int(self.window_seconds * _rate(take.time) / 2.0) + 1
        if len(bridged) < window or window <= self.order + 1:
            return bridged
        smooth = savgol_filter(np.nan_to_num(bridged), window, self.order, axis=0)
        return np.where(np.isnan(bridged), np.nan, smooth)


class OneEuro:
    """Low-pass filter whose cutoff rises with speed: calm at rest, prompt in motion.

    Casiez, Roussel & Vogel 2012, 1 Euro Filter, CHI '12. A joint's three coordinates
    share the cutoff of its speed, so that the result does not depend on the axes.
    Missing joints hang on their last bones, those not yet seen as in rest posture.

    Args:
        skeleton: The joints.
        min_cutoff: Cutoff at rest [Hz].
        beta: Rise of the cutoff with speed [1/m]. In steady motion a joint trails by
            less than 1 / (2 pi beta).
        derivative_cutoff: Cutoff of the speed itself [Hz].
    """

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        min_cutoff: float = 1.0,
        beta: float = 16.0,
        derivative_cutoff: float = 1.0,
    ) -> None:
        self.skeleton = skeleton
        self.min_cutoff = min_cutoff
        self.beta = beta
        self.derivative_cutoff = derivative_cutoff
        self._hold = Hold(skeleton)
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()
        self._time: float | None = None
        self._last = np.zeros((len(self.skeleton), 3))
        self._velocity = np.zeros((len(self.skeleton), 3))
        self._known = np.zeros(len(self.skeleton), dtype=bool)

    def step(self, observation: Observation) -> Correction:
        """Filter the next frame; time stamps increase, and may start at 0."""
        measured = observation.positions
        if self._time is not None:
            step = max(observation.time - self._time, _LEAST_STEP)
            measured = self._filter(measured, step)
        result = self._hold.step(replace(observation, positions=measured))
        self._time, self._last = observation.time, result.positions
        self._known = self._known | ~np.isnan(measured[:, 0])
        return result

    def _filter(self, measured: Array, step: float) -> Array:
        """Return the filtered frame [m], NaN where missing, (J, 3) (algorithm 1)."""
        away = np.where(self._known[:, None], measured - self._last, 0.0)
        # A missing joint is held, so it comes to rest.
        velocity = np.nan_to_num(away) / step
        share = _share(np.array(self.derivative_cutoff), step)
        self._velocity = self._velocity + share * (velocity - self._velocity)
        speed = np.sqrt(np.sum(self._velocity**2, axis=1, keepdims=True))
        cutoff = self.min_cutoff + self.beta * speed
        smooth = self._last + _share(cutoff, step) * away
        return np.where(self._known[:, None], smooth, measured)


def _share(cutoff: Array, step: float) -> Array:
    """Return the newest value's share, alpha, in exponential smoothing."""
    turn = 2.0 * np.pi * cutoff * step
    return np.asarray(turn / (turn + 1.0))
