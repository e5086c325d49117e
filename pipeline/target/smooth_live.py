"""Smoothing of live joints, by where they were in the last quarter of a second."""

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import values_at

STEP = 1.0 / 30.0  # s between the places that count
AT_REST = np.array([0.2777, 0.2394, 0.1617, 0.0958, 0.0435, 0.0073, -0.0082])
MOVING = np.array([0.4259, 0.1855, 0.0503, -0.0022, -0.0277, -0.0536, -0.0684])
"""Weights of where a joint was 1 to 7 steps before, relative to where it is now, at
rest and in motion (``pipeline.lab.smoothing_lessons``). The latter keep steady motion.
"""
# m/s: at rest, in motion, and so fast that nothing is smoothed; in between, weights
# change with the logarithm of the speed, relative to the body as a whole. The first
# two were chosen as RESULTS says under "Smoothing", the last on every other sequence
# of punches and kicks.
_REST, _MOTION, _FAST = 0.15, 1.2, 3.0
_TRAVEL_CUTOFF = 0.5  # Hz, of the velocity of the body as a whole
_LEAST_TRAVEL = 1e-3  # m/s
_JUMP = 15.0  # m/s: what is faster than a hand has jumped, and has no past. A guess.
_SPEED_CUTOFF = 1.0  # Hz, of the velocity that tells the speed
_LEAST_STEP = 1e-3  # s


class LiveSmoother:
    """Smooths joints frame by frame, without lag in steady motion.

    Each joint is at a weighted mean of where it is and was. The weights bring it
    nearest to its path as smoothed in whole takes, with small third differences: a
    Wiener filter of finite length that is also to move smoothly. Where joints were is
    counted from the body as a whole, which carries them along when it walks.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._hips, self._legs = skeleton.hips, skeleton.legs
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
            self._travel = np.zeros(3)
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
        turn = 2.0 * np.pi * _TRAVEL_CUTOFF * step
        level = velocity[self._hips].mean(axis=0) * [1.0, 0.0, 1.0]
        self._travel += turn / (turn + 1.0) * (level - self._travel)
        carried = self._carried()
        past = values_at(self._times, self._places, before)
        past += (time - before)[:, None, None] * carried
        weights = _weights(np.linalg.norm(self._velocity - carried, axis=1))
        change = np.einsum("kjc,jk->jc", past - positions, weights)
        self._last = np.asarray(positions + change)
        return self._last

    def _carried(self) -> Array:
        """Return the velocity [m/s] with which the body carries its joints (J, 3).

        Legs, which also stand, are carried as far as they move with it.
        """
        squared = max(float(self._travel @ self._travel), _LEAST_TRAVEL**2)
        shares = np.ones(len(self._velocity))
        along = self._velocity[self._legs] @ self._travel
        shares[self._legs] = (along / squared).clip(0.0, 1.0)
        return np.asarray(shares[:, None] * self._travel)


def _weights(speed: Array) -> Array:
    """Return the weights of joints (J, 7), given their speeds [m/s] (J,)."""
    moving, fast = (
        np.log(np.maximum(speed, low) / low) / np.log(high / low)
        for low, high in ((_REST, _MOTION), (_MOTION, _FAST))
    )
    share = moving.clip(0.0, 1.0)[:, None]
    slow = 1.0 - fast.clip(0.0, 1.0)[:, None]
    return np.asarray(slow * (share * MOVING + (1.0 - share) * AT_REST))
