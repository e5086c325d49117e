"""Which frame is shown when: playing, pausing and stepping through time stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SHORTEST = 1.0 / 60.0  # s between two pictures: screens show no more


class Playback:
    """A place in a motion, at rest or going on with a clock; the end leads back.

    Args:
        time: Time stamps [s], shape (T,), never decreasing.
    """

    def __init__(self, time: NDArray[np.float64]) -> None:
        self._since = time - time[0]
        steps = np.diff(time)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
        self._length = float(self._since[-1]) + step  # the last frame is seen as well
        self._frame = 0
        self._began: float | None = None  # clock at which the motion began, or would
        self._speed = 1.0

    @property
    def playing(self) -> bool:
        """Whether time goes on."""
        return self._began is not None

    def seconds(self, frame: int) -> float:
        """Return when a frame is [s], counted from the first."""
        return float(self._since[frame])

    def frame(self, clock: float) -> int:
        """Return the frame that is shown when a clock [s] says so."""
        if self._began is None:
            return self._frame
        now = (clock - self._began) * self._speed % self._length
        return int(np.searchsorted(self._since, now, side="right")) - 1

    def play(self, clock: float) -> None:
        """Go on from the present frame; from the first, if it is the last."""
        if not self.playing:
            last = self._frame == len(self._since) - 1
            self._start(0 if last else self._frame, clock)

    def pause(self, clock: float) -> None:
        """Stay at the present frame."""
        self._frame, self._began = self.frame(clock), None

    def seek(self, frame: int) -> None:
        """Stay at a frame, or the nearest there is."""
        self._frame = min(max(frame, 0), len(self._since) - 1)
        self._began = None

    def change_speed(self, speed: float, clock: float) -> None:
        """Play so many times as fast from now on."""
        playing, frame = self.playing, self.frame(clock)
        self._speed = speed
        if playing:
            self._start(frame, clock)

    def until_next(self, clock: float) -> float | None:
        """Return how long [s] the present picture stays; None: until asked."""
        if self._began is None:
            return None
        now = (clock - self._began) * self._speed % self._length
        after = int(np.searchsorted(self._since, now, side="right"))
        end = self._since[after] if after < len(self._since) else self._length
        return max(float(end - now) / self._speed, _SHORTEST)

    def _start(self, frame: int, clock: float) -> None:
        self._began = clock - float(self._since[frame]) / self._speed
