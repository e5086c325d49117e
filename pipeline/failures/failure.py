"""A gross failure of the tracker, and the frames that it goes on for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Take
from kinefilter.retarget.runs import runs


class FailureKind(StrEnum):
    """What is wrong with part of a take."""

    MIRRORED = "left and right exchanged"
    BENT_BACKWARDS = "bent backwards at the knee"
    THROUGH_HEAD = "through the head"
    OUT_OF_RANGE = "beyond the shoulder's range"
    LEAPING = "leaping faster than limbs move"


@dataclass(frozen=True)
class Failure:
    """A stretch of a take in which the tracker failed."""

    kind: FailureKind
    """What is wrong."""
    part: str
    """What it is wrong with: ``body``, or ``left`` or ``right`` and ``arm`` or
    ``leg``."""
    first: int
    """The first frame of it."""
    last: int
    """The last frame of it."""
    start: float
    """Time stamp of the first frame [s]."""
    end: float
    """Time stamp of the last frame [s]."""

    @property
    def frames(self) -> slice:
        """The frames of it."""
        return slice(self.first, self.last + 1)

    def __str__(self) -> str:
        return f"{self.part} {self.kind} from {self.start:.1f} to {self.end:.1f} s"


def lasting(
    take: Take,
    kind: FailureKind,
    part: str,
    frames: NDArray[np.bool_],
    *,
    shortest: float = 0.0,
) -> list[Failure]:
    """Return the stretches of a failure.

    Args:
        take: The recording.
        kind: What is wrong.
        part: What it is wrong with.
        frames: In which frames it is, shape (T,).
        shortest: Stretches shorter than this are left out [s].
    """
    time = take.time
    ends = [(run.start, run.stop - 1) for run in runs(frames)]
    return [
        Failure(kind, part, a, b, float(time[a]), float(time[b]))
        for a, b in ends
        if time[b] - time[a] >= shortest
    ]
