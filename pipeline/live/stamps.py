"""The time stamps of one person's frames, in whatever order they come."""

from __future__ import annotations

from collections import deque
from enum import Enum, auto

import numpy as np

_STARTED_ANEW = 2.0
"""A stamp this much [s] before the last is no late frame: the sender's clock began
anew."""
_STEPS = 15  # steps of which the median is the sender's: half a second
_LONGEST_GAP = 2.0  # s: after that the person was gone, and no frame is missing


class Arrival(Enum):
    """How a frame comes."""

    NEXT = auto()
    """In order."""
    REPEATED = auto()
    """With the stamp of the last."""
    LATE = auto()
    """After one that was taken later."""
    ANEW = auto()
    """First of a clock that began anew."""


class Stamps:
    """Tells frames in order from those that are not."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._steps: deque[float] = deque(maxlen=_STEPS)

    def arrive(self, time: float) -> tuple[Arrival, int]:
        """Take the stamp of a frame.

        Args:
            time: The sensor's stamp [s].

        Returns:
            How it comes, and how many frames seem to be missing before it: by how many
            times the usual step the stamps are apart.
        """
        last, self._last = self._last, time
        if last is None:
            return Arrival.NEXT, 0
        step = time - last
        if step < -_STARTED_ANEW:
            self._steps.clear()
            return Arrival.ANEW, 0
        if step <= 0.0:
            self._last = last
            return (Arrival.LATE if step < 0.0 else Arrival.REPEATED), 0
        missing = 0
        if len(self._steps) == _STEPS and step < _LONGEST_GAP:
            missing = max(0, round(step / float(np.median(self._steps))) - 1)
        self._steps.append(step)
        return Arrival.NEXT, missing
