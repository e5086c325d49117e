"""Smoothing of live joints, by where they were in the last quarter of a second."""

import numpy as np

from kinefilter.characters.arrays import Array

STEP = 1.0 / 30.0  # s between the places that count
AT_REST = np.array([0.2743, 0.2436, 0.1714, 0.0974, 0.0355, 0.0087, -0.0029])
MOVING = np.array([0.4590, 0.2189, 0.0583, -0.0157, -0.0419, -0.0597, -0.0631])
"""Weights of where a joint was 1 to 7 steps before, relative to where it is now, at
rest and in motion (``pipeline.lab.smoothing_lessons``). The latter keep steady motion.
"""
_REST, _MOTION = 0.1, 0.5  # m/s; between, weights change with the speed's logarithm
_SPEED_CUTOFF = 1.0  # Hz, of the velocity that tells the speed
_LEAST_STEP = 1e-3  # s


class LiveSmoother:
    """Smooths joints frame by frame, without lag in steady motion.

    Each joint is at a weighted mean of where it is and was. The weights bring it
    nearest to its path as smoothed in whole takes, with small third differences: a
    Wiener filter of finite length that is also to move smoothly.
    """

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._times: Array = np.zeros(0)
        self._places: Array | None = None

    def step(self, positions: Array, time: float) -> Array:
        """Smooth the next frame's joints [m] (J, 3), its time stamp [s] increasing."""
        if self._places is None:
            self._times, self._places = np.array([time]), positions[None].copy()
            self._velocity = np.zeros_like(positions)
            return positions
        step = max(time - self._times[-1], _LEAST_STEP)
        turn = 2.0 * np.pi * _SPEED_CUTOFF * step
        velocity = (positions - self._places[-1]) / step
        self._velocity += turn / (turn + 1.0) * (velocity - self._velocity)
        speed = np.linalg.norm(self._velocity, axis=1)[:, None]
        before = time - STEP * np.arange(1.0, len(MOVING) + 1.0)
        kept = max(int(np.searchsorted(self._times, before[-1], "right")) - 1, 0)
        self._times = np.append(self._times[kept:], time)
        self._places = np.concatenate([self._places[kept:], positions[None]])
        past = places_at(before, self._times, self._places)
        weights = weights_for(speed)
        change = np.einsum("kjc,jk->jc", past - positions, weights)
        return np.asarray(positions + change)


def places_at(when: Array, times: Array, places: Array) -> Array:
    """Return places (T, ...) interpolated at times [s] (K,), the first before them."""
    after = np.searchsorted(times, when).clip(1, len(times) - 1)
    share = (when - times[after - 1]) / (times[after] - times[after - 1])
    shares = share.clip(0.0, 1.0).reshape(-1, *[1] * (places.ndim - 1))
    return np.asarray(places[after - 1] + shares * (places[after] - places[after - 1]))


def weights_for(speed: Array) -> Array:
    """Return the weights (..., 7) of joints at a speed [m/s] (..., 1)."""
    logs = np.log(np.maximum(speed, _REST) / _REST) / np.log(_MOTION / _REST)
    share = logs.clip(0.0, 1.0)
    return np.asarray(share * MOVING + (1.0 - share) * AT_REST)
