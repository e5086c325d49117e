"""The playback position in a motion."""

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import nominal_step

_SHORTEST = 1.0 / 60.0  # s between two pictures: screens show no more


class Playback:
    """A position in a motion, paused or ``playing`` in a loop by a clock."""

    def __init__(self, time: Array) -> None:
        last = np.nan_to_num(nominal_step(time), nan=1.0)
        self._starts = time - time[0]
        self._ends = np.append(self._starts[1:], self._starts[-1] + last)
        self._frame, self._speed, self.playing = 0, 1.0, False
        self._began = 0.0  # clock time of frame 0 while playing

    def frame(self, clock: float) -> int:
        """Return the frame shown at a clock time [s]."""
        if not self.playing:
            return self._frame
        return int(np.searchsorted(self._ends[:-1], self._now(clock), side="right"))

    def play(self, clock: float) -> None:
        """Play from the current frame, or from the first if it is the last."""
        if not self.playing:
            last = self._frame == len(self._starts) - 1
            self._start(0 if last else self._frame, clock)

    def pause(self, clock: float) -> None:
        """Pause at the current frame."""
        self.seek(self.frame(clock))

    def seek(self, frame: int) -> None:
        """Pause at a frame, clipped to the motion."""
        self._frame = min(max(frame, 0), len(self._starts) - 1)
        self.playing = False

    def change_speed(self, speed: float, clock: float) -> None:
        """Play ``speed`` times as fast as recorded from now on."""
        frame, self._speed = self.frame(clock), speed
        if self.playing:
            self._start(frame, clock)

    def until_next(self, clock: float) -> float | None:
        """Return the time [s] until the picture changes; None when paused."""
        if not self.playing:
            return None
        left = self._ends[self.frame(clock)] - self._now(clock)
        return max(float(left) / self._speed, _SHORTEST)

    def _now(self, clock: float) -> float:
        return (clock - self._began) * self._speed % float(self._ends[-1])

    def _start(self, frame: int, clock: float) -> None:
        self._began, self.playing = clock - self._starts[frame] / self._speed, True
