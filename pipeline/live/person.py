"""One person of a stream: measured first, then followed by a character."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, State, Take, skeleton_named, standard_body
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.reliability import measure_body

from .config import LiveConfig
from .messages import SeenBody, stacked

_MEASURED_FOR = 1.0
"""Time [s] that a person is measured for. In recorded takes segment lengths are then on
average 7 mm from those of the whole take, after 3 s 5 mm."""
_ENOUGH = 15  # good frames in it
_LONGEST = 3.0  # s; a person half hidden for that long is measured all the same
_MOST_FRAMES = 120  # kept meanwhile, whatever the rate
_WELL_SEEN = 0.8  # share of joints tracked in a good frame. A guess.


def make_avatar(body: Body, config: LiveConfig) -> Avatar:
    """Return the character of a person's body."""
    return Avatar(body, config.scene, floor=config.floor)


class Person:
    """Follows one person.

    With a height the standard body of that height is followed from the first frame.
    Without, the person's segments are measured in the first second or so, and poses
    begin after it.
    """

    def __init__(self, config: LiveConfig) -> None:
        self._config, self._skeleton = config, skeleton_named(config.skeleton)
        self._avatar: Avatar | None = None
        self._frames: list[tuple[float, SeenBody]] = []
        if config.height is not None:
            height, mass = config.height, config.mass
            body = standard_body(self._skeleton, height=height, mass=mass)
            self._avatar = make_avatar(body, config)

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
        take = Take(*stacked(frames), self._skeleton, "live")
        body = measure_body(take, mass=self._config.mass)
        self._avatar = make_avatar(body, self._config)
        self._frames.clear()


def _well_seen(seen: SeenBody) -> bool:
    tracked: NDArray[np.bool_] = seen.state == State.TRACKED
    return bool(tracked.mean() >= _WELL_SEEN)
