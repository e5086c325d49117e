"""The people who are there, and the newest frame of each that waits for its pose."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from .messages import Frame, SeenBody
from .person import Person
from .tally import Event, Tally

_GONE = 2.0  # s unseen after which a person is dropped
_RESTARTED = 2.0  # s before the last stamp: the sender's clock restarted
_STEPS = 15  # steps of which the median is the sender's: half a second
_LONGEST_GAP = 2.0  # s: after that the person was gone, and no frame is missing


class Stamps:
    """The time stamps of one person's frames, in whatever order they come."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._steps: deque[float] = deque(maxlen=_STEPS)

    def arrive(self, time: float) -> tuple[Event | None, int]:
        """Take the sensor's stamp [s] of a frame.

        Returns:
            Whether it is REPEATED, LATE or the first of a clock that RESTARTED, or None
            if it is in order; and how many frames seem to be missing before it: by how
            many times the usual step the stamps are apart.
        """
        last, self._last = self._last, time
        if last is None:
            return None, 0
        step = time - last
        if step < -_RESTARTED:
            self._steps.clear()
            return Event.RESTARTED, 0
        if step <= 0.0:
            self._last = last
            return (Event.LATE if step < 0.0 else Event.REPEATED), 0
        missing = 0
        if len(self._steps) == _STEPS and step < _LONGEST_GAP:
            missing = max(0, round(step / float(np.median(self._steps))) - 1)
        self._steps.append(step)
        return None, missing


@dataclass(frozen=True, eq=False)
class Waiting:
    """A person's frame that waits for its pose."""

    seen: SeenBody
    time: float  # the frame's stamp [s]
    arrived: float  # when it came [s], of our own clock
    since: float  # since when the person waits for a pose [s], of our own clock
    restarted: bool  # whether the sender's clock restarted since the last pose


@dataclass(eq=False)
class Presence:
    """A person in front of the sensor."""

    id: str  # the sender's name for the person
    slot: int  # the lowest number, from 0, that was free when the person came
    last_seen: float  # when a frame with the person came [s], of our own clock
    person: Person | None = None  # from the first pose on
    stamps: Stamps = field(default_factory=Stamps)
    waiting: Waiting | None = None  # the newest frame without a pose


class Crowd:
    """All people who are there.

    The newest frame wins: where poses take longer than frames come, older frames are
    dropped and counted.
    """

    def __init__(self, most: int, tally: Tally) -> None:
        self._most, self._tally = most, tally
        self._here: dict[str, Presence] = {}

    def __len__(self) -> int:
        return len(self._here)

    @property
    def measuring(self) -> int:
        """How many people are there and not measured yet."""
        people = [presence.person for presence in self._here.values()]
        return sum(person is None or person.body is None for person in people)

    def arrive(self, frame: Frame, now: float) -> list[SeenBody]:
        """Take in a frame.

        Args:
            frame: What a sensor saw.
            now: The time [s] of our own clock, which does not go back.

        Returns:
            The bodies whose frame is new and in order, for a recording.
        """
        self._tally.count(Event.FRAMES)
        new = []
        for seen in frame.bodies:
            presence = self._presence(seen, now)
            if presence is not None and self._take_in(presence, seen, frame.time, now):
                new.append(seen)
        return new

    def next(self) -> tuple[Presence, Waiting] | None:
        """Take the frame of the person who has waited longest; None: none waits."""
        waiting = [(p, p.waiting) for p in self._here.values() if p.waiting is not None]
        if not waiting:
            return None
        presence, frame = min(waiting, key=lambda pair: pair[1].since)
        presence.waiting = None
        return presence, frame

    def drop_gone(self, now: float) -> list[Presence]:
        """Drop, and return, the people who have not been seen for 2 s."""
        gone = [p for p in self._here.values() if now - p.last_seen > _GONE]
        for presence in gone:
            del self._here[presence.id]
            self._tally.count(Event.RESTED)
        return gone

    def _presence(self, seen: SeenBody, now: float) -> Presence | None:
        """Return whose frame it is, if there is room for the person."""
        if not seen.is_seen:
            self._tally.count(Event.UNSEEN)
            return None
        if seen.id not in self._here:
            if len(self._here) >= self._most:
                self._tally.count(Event.CROWDED)
                return None
            taken = {presence.slot for presence in self._here.values()}
            slot = min(set(range(self._most)) - taken)
            self._here[seen.id] = Presence(seen.id, slot, now)
        presence = self._here[seen.id]
        presence.last_seen = now
        return presence

    def _take_in(
        self, presence: Presence, seen: SeenBody, time: float, now: float
    ) -> bool:
        """Keep a person's frame; tell whether it is new and in order."""
        event, missing = presence.stamps.arrive(time)
        self._tally.count(Event.MISSING, missing)
        if event is not None:
            self._tally.count(event)
        if event in (Event.REPEATED, Event.LATE):
            return False
        restarted, since = event is Event.RESTARTED, now
        if presence.waiting is not None:
            self._tally.count(Event.DROPPED)
            restarted |= presence.waiting.restarted
            since = presence.waiting.since
        presence.waiting = Waiting(seen, time, now, since, restarted)
        return True
