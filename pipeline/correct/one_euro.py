"""The One-Euro filter, which smooths live motion."""

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

from .hold import Hold
from .interface import Correction, Corrector, Observation

_LEAST_STEP = 1e-3  # s: avoids a division by zero at repeated time stamps
_TOP_SPEED = 5.0  # m/s: a root that is faster has jumped, and carries nothing. A guess.


@dataclass(eq=False, repr=False)
class OneEuro(Corrector):
    """Low-pass filter whose cutoff rises with speed: steady at rest, prompt in motion.

    Casiez, Roussel & Vogel 2012, 1 Euro Filter, CHI '12. The three coordinates of a
    joint share one cutoff, so the result does not depend on the axes. Missing joints
    keep their last bones; joints not measured yet are placed as in the rest pose.
    """

    skeleton: Skeleton
    _: KW_ONLY
    min_cutoff: float = 1.0  # cutoff at rest [Hz]
    beta: float = 16.0
    """Rise of the cutoff with speed [1/m]. In steady motion a joint lags by less than
    1 / (2 pi beta)."""
    derivative_cutoff: float = 1.0  # cutoff of the speed itself [Hz]
    walking_speed: float = np.inf
    """Speed of the root [m/s] above which it carries other joints along: each is
    filtered relative to the part of the root's velocity that it shares. Thus the trunk
    of a walker is smoothed as at rest, and a standing foot is not dragged along.
    Infinite, as in the paper: nothing is carried."""

    def __post_init__(self) -> None:
        self._hold = Hold(self.skeleton)
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._hold.start()
        self._time: float | None = None
        self._velocity = np.zeros((len(self.skeleton), 3))
        self._walk = np.zeros(3)  # velocity of the root, as far as it walks [m/s]

    def step(self, observation: Observation) -> Correction:
        """Filter the next frame; time stamps increase, and may start at 0."""
        measured = observation.positions
        if self._time is not None:
            step = max(observation.time - self._time, _LEAST_STEP)
            measured = self._filter(measured, step)
        self._time = observation.time
        return self._hold.step(replace(observation, positions=measured))

    def _filter(self, positions: Array, step: float) -> Array:
        """Return the filtered frame [m], NaN where missing, (J, 3) (algorithm 1)."""
        last, known = self._hold.last, self._hold.measured[:, None]
        change = np.where(known, positions - last, 0.0)
        # A missing joint is held, so it comes to rest.
        velocity = np.where(np.isnan(change), 0.0, change) / step
        share = _newest_share(np.array(self.derivative_cutoff), step)
        self._velocity = self._velocity + share * (velocity - self._velocity)
        root = velocity[self.skeleton.root]
        walks = root if np.linalg.norm(root) < _TOP_SPEED else 0.0
        self._walk = walk = self._walk + share * (walks - self._walk)
        # The part of the root's velocity that each joint shares [m/s].
        shared = self._velocity @ walk / (walk @ walk + self.walking_speed**2)
        carried = np.where(known, shared.clip(0.0, 1.0)[:, None] * walk, 0.0)
        speed = np.linalg.norm(self._velocity - carried, axis=1, keepdims=True)
        cutoff = self.min_cutoff + self.beta * speed
        moved = carried * step
        smooth = last + moved + _newest_share(cutoff, step) * (change - moved)
        return np.where(known, smooth, positions)


def _newest_share(cutoff: Array, step: float) -> Array:
    """Return alpha, the share of the newest value in exponential smoothing."""
    turn = 2.0 * np.pi * cutoff * step
    return np.asarray(turn / (turn + 1.0))
