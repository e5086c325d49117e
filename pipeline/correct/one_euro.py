"""The 1 euro filter, which live motion is smoothed with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

from .hold import Hold
from .interface import Correction, Corrector, Observation

_LEAST_STEP = 1e-3  # s: a repeated time stamp is no reason to divide by zero


class OneEuro(Corrector):
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
