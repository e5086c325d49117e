"""One person of a stream: measured first, then followed by a character."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Skeleton, State, Take, standard_body
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.retarget import measured_body

from .messages import SeenBody

_MEASURED_FOR = 1.0
"""Time [s] that a person is measured for. In recorded takes segment lengths are then on
average 7 mm from those of the whole take, after 3 s 5 mm."""
_ENOUGH = 15  # good frames in it
_LONGEST = 3.0  # s; a person half hidden for that long is measured all the same
_MOST_FRAMES = 120  # kept meanwhile, whatever the rate
_WELL_SEEN = 0.8  # share of joints tracked in a good frame. A guess.


@dataclass(frozen=True)
class PersonSettings:
    """What is known of every person beforehand."""

    skeleton: Skeleton
    height: float | None = None  # [m]; None: each person is measured
    mass: float | None = None  # [kg]; None: estimated from the height
    scene: str | Path | None = None  # what is around each; a scene or an MJCF file
    floor: float | None = None  # its height in the sensor's frame [m]; None: under feet

    def avatar(self, body: Body) -> Avatar:
        """Return the character of a body."""
        return Avatar(body, self.scene, floor=self.floor)


class Person:
    """Follows one person.

    With a height the standard body of that height is followed from the first frame.
    Without, the person's segments are measured in the first second or so, and poses
    begin after it.

    Args:
        settings: What is known of the person.
    """

    def __init__(self, settings: PersonSettings) -> None:
        self._settings = settings
        self._avatar: Avatar | None = None
        self._frames: list[tuple[float, SeenBody]] = []
        if settings.height is not None:
            body = standard_body(
                settings.skeleton, height=settings.height, mass=settings.mass
            )
            self._avatar = settings.avatar(body)

    @property
    def body(self) -> Body | None:
        """The person's body, None before it is measured."""
        return None if self._avatar is None else self._avatar.body

    def start(self) -> None:
        """Start over, as the sender's clock does."""
        self._frames.clear()
        if self._avatar is not None:
            self._avatar.start()

    def step(self, seen: SeenBody, time: float) -> Pose | None:
        """Follow the next frame.

        Args:
            seen: What the sensor sees of the person.
            time: Its stamp [s], later than the last.

        Returns:
            The pose, or None while the person is measured.
        """
        if self._avatar is not None:
            return self._avatar.step(seen.positions, time, seen.state)
        if len(self._frames) < _MOST_FRAMES:
            self._frames.append((time, seen))
        good = [(t, s) for t, s in self._frames if _well_seen(s)]
        long_enough = good and good[-1][0] - good[0][0] >= _MEASURED_FOR
        if len(good) >= _ENOUGH and long_enough:
            self._measure(good)
        elif time - self._frames[0][0] >= _LONGEST:
            self._measure(self._frames)
        return None

    def _measure(self, frames: list[tuple[float, SeenBody]]) -> None:
        take = _take(frames, self._settings.skeleton)
        reference = measure_reference(take)
        body = measured_body(
            take.skeleton,
            reference.lengths,
            reference.directions,
            mass=self._settings.mass,
        )
        self._avatar = self._settings.avatar(body)
        self._frames.clear()


def _well_seen(seen: SeenBody) -> bool:
    tracked: NDArray[np.bool_] = seen.state == State.TRACKED
    return bool(tracked.mean() >= _WELL_SEEN)


def _take(frames: list[tuple[float, SeenBody]], skeleton: Skeleton) -> Take:
    return Take(
        np.array([time for time, _ in frames]),
        np.array([seen.positions for _, seen in frames]),
        np.array([seen.state for _, seen in frames]),
        skeleton,
        "live",
    )
