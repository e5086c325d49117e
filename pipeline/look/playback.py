"""Which frame is shown when: playing, pausing and stepping through time stamps."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

_SHORTEST = 1.0 / 60.0  # s between two pictures: screens show no more


class Playback:
    """A place in a motion, at rest or running with a clock; the end leads back."""

    def __init__(self, time: Array) -> None:
        self._since = time - time[0]
        steps = np.diff(time)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
        self._length = float(self._since[-1]) + step  # the last frame is seen as well
        self._frame = 0
        self._began: float | None = None  # clock at which frame 0 was or would be
        self._speed = 1.0

    @property
    def playing(self) -> bool:
        """Whether time runs."""
        return self._began is not None

    def frame(self, clock: float) -> int:
        """Return the frame that is shown at a time of the clock [s]."""
        if self._began is None:
            return self._frame
        now = self._now(clock, self._began)
        return int(np.searchsorted(self._since, now, side="right")) - 1

    def play(self, clock: float) -> None:
        """Go on from the present frame, or from the first if it is the last."""
        if not self.playing:
            last = self._frame == len(self._since) - 1
            self._start(0 if last else self._frame, clock)

    def pause(self, clock: float) -> None:
        """Stay at the present frame."""
        self.seek(self.frame(clock))

    def seek(self, frame: int) -> None:
        """Stay at a frame, or at the nearest there is."""
        self._frame = min(max(frame, 0), len(self._since) - 1)
        self._began = None

    def change_speed(self, speed: float, clock: float) -> None:
        """Play ``speed`` times as fast from now on."""
        playing, frame = self.playing, self.frame(clock)
        self._speed = speed
        if playing:
            self._start(frame, clock)

    def until_next(self, clock: float) -> float | None:
        """Return how long [s] the present picture stays; None at rest."""
        if self._began is None:
            return None
        now = self._now(clock, self._began)
        after = int(np.searchsorted(self._since, now, side="right"))
        end = self._since[after] if after < len(self._since) else self._length
        return max(float(end - now) / self._speed, _SHORTEST)

    def _now(self, clock: float, began: float) -> float:
        return (clock - began) * self._speed % self._length

    def _start(self, frame: int, clock: float) -> None:
        self._began = clock - float(self._since[frame]) / self._speed
