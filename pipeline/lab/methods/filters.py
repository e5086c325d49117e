"""Smoothing filters, which know noise, and nothing of bodies: baselines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.signal import butter, savgol_filter, sosfiltfilt

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct.interface import (
    Correction,
    Corrector,
    Observation,
    measured_only,
)


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


class Butterworth(Corrector):
    """Low-pass filter over the frames, forward and backward, so without lag.

    Gaps are bridged first. A take shorter than the filter's padding, or with a frame
    rate that cannot hold the cutoff, is bridged only.

    Args:
        cutoff: Frequency [Hz] at which half of the amplitude is left: each of the two
            passes leaves 1 / sqrt(2).
        order: Order of one pass.
    """

    def __init__(
        self,
        skeleton: Skeleton | None = None,  # noqa: ARG002 - any will do
        *,
        cutoff: float = 6.0,
        order: int = 2,
    ) -> None:
        self.cutoff = cutoff
        self.order = order

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Filter a whole take; joints that were never seen stay NaN."""
        return measured_only(self._filtered(take))

    def _filtered(self, take: Observation) -> Array:
        bridged, rate = bridge_gaps(take.time, take.positions), _rate(take.time)
        padding = 3 * (self.order + 1)
        if len(bridged) <= padding or 2.0 * self.cutoff >= rate:
            return bridged
        sections = butter(self.order, self.cutoff, fs=rate, output="sos")
        smooth = sosfiltfilt(sections, np.nan_to_num(bridged), 0, padlen=padding)
        return np.where(np.isnan(bridged), np.nan, smooth)


class SavitzkyGolay(Corrector):
    """Least-squares polynomials over a sliding window, which have no lag.

    Gaps are bridged first. A take shorter than the window, or with so low a frame rate
    that a polynomial fits the window's frames exactly, is bridged only.

    Args:
        window_seconds: Length of the window [s], rounded to an odd number of frames.
        order: Order of the polynomials: motion of this order passes unchanged.
    """

    def __init__(
        self,
        skeleton: Skeleton | None = None,  # noqa: ARG002 - any will do
        *,
        window_seconds: float = 0.3,
        order: int = 3,
    ) -> None:
        self.window_seconds = window_seconds
        self.order = order

    def whole(
        self,
        take: Observation,
        frames: Iterable[int] | None = None,  # noqa: ARG002 - at once
    ) -> Correction:
        """Filter a whole take; joints that were never seen stay NaN."""
        return measured_only(self._filtered(take))

    def _filtered(self, take: Observation) -> Array:
        bridged = bridge_gaps(take.time, take.positions)
        window = 2 * int(self.window_seconds * _rate(take.time) / 2.0) + 1
        if len(bridged) < window or window <= self.order + 1:
            return bridged
        smooth = savgol_filter(np.nan_to_num(bridged), window, self.order, axis=0)
        return np.where(np.isnan(bridged), np.nan, smooth)
