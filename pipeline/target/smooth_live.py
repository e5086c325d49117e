"""Smoothing of live joints, by where they were in the last quarter of a second."""

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import values_at

STEP = 1.0 / 30.0  # s between the places that count
AT_REST = np.array([0.2760, 0.2462, 0.1716, 0.0958, 0.0344, 0.0064, -0.0039])
MOVING = np.array([0.4315, 0.1823, 0.0396, -0.0123, -0.0281, -0.0489, -0.0616])
"""Weights of where a joint was 1 to 7 steps before, relative to where it is now, at
rest and in motion (``pipeline.lab.smoothing_lessons``). The latter keep steady motion.
"""
# m/s: at rest, in motion, and so fast that nothing is smoothed; in between, weights
# change with the logarithm of the speed. Chosen on s02, s04, p00, p04 and p08 and on
# every other sequence of punches and kicks.
_REST, _MOTION, _FAST = 0.2, 0.6, 3.0
_WALKING = 0.5  # m/s: a root that walks faster carries other joints along
_JUMP = 15.0  # m/s: what is faster than a hand has jumped, and has no past. A guess.
_SPEED_CUTOFF = 1.0  # Hz, of the velocity that tells the speed
_LEAST_STEP = 1e-3  # s


class LiveSmoother:
    """Smooths joints frame by frame, without lag in steady motion.

    Each joint is at a weighted mean of where it is and was. The weights bring it
    nearest to its path as smoothed in whole takes, with small third differences: a
    Wiener filter of finite length that is also to move smoothly.
    """

    def __init__(self, root: int) -> None:
        self._root = root
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._times: Array = np.zeros(0)
        self._places: Array | None = None

    def step(self, positions: Array, time: float) -> Array:
        """Smooth the next frame's joints [m] (J, 3), its time stamp [s] increasing."""
        if self._places is None:
            self._times, self._places = np.array([time]), positions[None].copy()
            self._last, self._velocity = positions, np.zeros_like(positions)
            return positions
        step = max(time - self._times[-1], _LEAST_STEP)
        turn = 2.0 * np.pi * _SPEED_CUTOFF * step
        velocity = (positions - self._last) / step
        jumps = np.linalg.norm(positions - self._places[-1], axis=1) > _JUMP * step
        velocity[jumps], self._places[:, jumps] = 0.0, positions[jumps]
        self._velocity += turn / (turn + 1.0) * (velocity - self._velocity)
        before = time - STEP * np.arange(1.0, len(MOVING) + 1.0)
        kept = max(int(np.searchsorted(self._times, before[-1], "right")) - 1, 0)
        self._times = np.append(self._times[kept:], time)
        self._places = np.concatenate([self._places[kept:], positions[None]])
        past = values_at(self._times, self._places, before)
        weights = _weights(self._velocity, self._velocity[self._root])
        change = np.einsum("kjc,jk->jc", past - positions, weights)
        self._last = np.asarray(positions + change)
        return self._last


def _weights(velocity: Array, walk: Array) -> Array:
    """Return the weights of joints (J, 7), given velocities [m/s], also of the root.

    What joints share of the velocity of a root that walks does not make them fast.
    """
    walk = walk * [1.0, 0.0, 1.0]
    shared = (velocity @ walk / (walk @ walk + _WALKING**2)).clip(0.0, 1.0)
    alone = velocity - shared[:, None] * walk
    moving, fast = (
        np.log(np.maximum(np.linalg.norm(v, axis=1), low) / low) / np.log(high / low)
        for v, low, high in ((velocity, _REST, _MOTION), (alone, _MOTION, _FAST))
    )
    share = moving.clip(0.0, 1.0)[:, None]
    slow = 1.0 - fast.clip(0.0, 1.0)[:, None]
    return np.asarray(slow * (share * MOVING + (1.0 - share) * AT_REST))
