"""What a recorded file holds: a take of every person in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, State, Take
from kinefilter.characters.arrays import Array

_Path = TypeVar("_Path", bound=PurePath)

MOST_FRAMES = 1_000_000
"""Frames that a recording has at most: nine hours at 30 a second."""
_FASTEST = 2000.0  # frames a second, of marker mocap
_LARGEST_PERSON = 10.0  # m; no one spans that, in centimeters everyone does
_FARTHEST = 10_000.0  # m; no sensor sees that far, a damaged number may say so
_FRAMES_MEASURED = 1000  # enough for a median


@dataclass(frozen=True)
class Recording:
    """A file that a sensor or its tools wrote."""

    takes: tuple[Take, ...]
    """One a person, in the order in which they appear."""
    format: str
    """Name of the file's layout (pipeline.config.TakeFormat)."""
    unit: str = "m"
    """The file's own unit of length."""
    notes: tuple[str, ...] = ()
    """What the user should know about how it was read."""

    @property
    def main(self) -> int:
        """Index of the person who is seen in most frames."""
        seen = [int(_seen(take).sum()) for take in self.takes]
        return int(np.argmax(seen))

    def numbers(self, body: int | Literal["all"] | None) -> list[int]:
        """Return the numbers, from 1, of who is asked for.

        Args:
            body: A number, or all; None: who is seen in most frames.
        """
        if body == "all":
            return list(range(1, len(self.takes) + 1))
        return [self.main + 1 if body is None else body]

    def take(self, body: int | None = None) -> Take:
        """Return the take of a person.

        Args:
            body: Which, counted from 1; None: who is seen in most frames.

        Raises:
            InputError: There is no such person.
        """
        if body is None:
            return self.takes[self.main]
        if not 1 <= body <= len(self.takes):
            raise InputError(
                f"{self.takes[0].source}: has no body {body}, there "
                + ("is 1" if len(self.takes) == 1 else f"are {len(self.takes)}")
                + "; 'kinefilter info' lists them"
            )
        return self.takes[body - 1]


def numbered(path: _Path, body: int | None) -> _Path:
    """Return the path of one of several people: ``clip.2.usda`` for ``clip.usda``."""
    if body is None:
        return path
    return path.with_name(f"{path.stem}.{body}{path.suffix}")


def _seen(take: Take) -> NDArray[np.bool_]:
    return np.asarray((take.state > State.NOT_TRACKED).any(axis=1))


def missing_marked(
    positions: Array, state: NDArray[np.uint8]
) -> tuple[Array, NDArray[np.uint8]]:
    """Return positions and states with what is missing as NaN and not tracked.

    Missing is what is not tracked, not a number or exactly at the origin, where the
    sensors put what they do not see.

    Args:
        positions: Joint positions [m], shape (..., 3).
        state: Tracking states (State), shape (...).
    """
    seen = np.isfinite(positions).all(-1) & (positions != 0).any(-1) & (state > 0)
    return (
        np.where(seen[..., None], positions, np.nan),
        np.where(seen, state, State.NOT_TRACKED).astype(np.uint8),
    )


def check_length(frames: int, source: str) -> None:
    """Raise InputError for fewer than two frames or more than any recording's."""
    if frames < 2:
        raise InputError(
            f"{source}: has {frames} frame{'s' * (frames != 1)}, "
            "expected at least 2; record a longer take"
        )
    if frames > MOST_FRAMES:
        raise InputError(
            f"{source}: has more than {MOST_FRAMES:,} frames; cut it into shorter takes"
        )


def check_rate(time: Array, source: str) -> None:
    """Raise InputError for frames faster than any sensor's; times may repeat [s]."""
    distinct = 1 + int(np.sum(np.diff(time) > 0))
    if distinct > 1 and distinct > _FASTEST * (time[-1] - time[0]) + 2:
        raise InputError(
            f"{source}: {distinct} frames in {time[-1] - time[0]:.3g} s are more than "
            "any sensor takes; are the times in seconds?"
        )


def check_extent(positions: Array, source: str) -> None:
    """Raise InputError where nobody is seen or no one can be that tall."""
    seen = np.flatnonzero(np.isfinite(positions[..., 0]).any(axis=1))
    if not len(seen):
        raise InputError(
            f"{source}: no joint is tracked in any of {len(positions)} frames (all "
            "zero, empty or state 0); record again with the person in view"
        )
    some = positions[seen[:: 1 + len(seen) // _FRAMES_MEASURED]]
    with np.errstate(over="ignore"):
        spans = np.fmax.reduce(some, axis=1) - np.fmin.reduce(some, axis=1)
    span = float(np.median(spans.max(axis=-1)))
    if span > _LARGEST_PERSON:
        unit, factor = ("milli", 1000) if span > 600 else ("centi", 100)
        raise InputError(
            f"{source}: the skeleton spans {span:.0f} m in a typical frame, expected a "
            f"person in meters; if the file is in {unit}meters, divide positions by "
            f"{factor}"
        )
    distance = np.fmax.reduce(np.abs(positions[seen]).reshape(len(seen), -1), axis=1)
    far = seen[distance > _FARTHEST]
    if len(far):
        raise InputError(
            f"{source}: frame {far[0] + 1} has a joint {distance.max():.3g} m away, "
            "expected a person before a sensor, in meters; correct or delete it"
        )
