"""Who is there, and the newest frame of each that waits for its pose."""

from __future__ import annotations

from dataclasses import dataclass, field

from .messages import Frame, SeenBody
from .person import Person, Stature
from .stamps import Arrival, Stamps
from .tally import Event, Tally

_GONE = 2.0  # s unseen after which a body is put to rest


@dataclass(frozen=True, eq=False)
class Waiting:
    """A person's frame that waits."""

    seen: SeenBody
    """What the sensor sees."""
    time: float
    """Its stamp [s]."""
    arrived: float
    """When it came [s], of our own clock."""
    since: float
    """Since when the person waits for a pose [s], of our own clock."""
    anew: bool
    """Whether the sender's clock began anew since the last pose."""


@dataclass(eq=False)
class Presence:
    """Somebody who is there."""

    id: str
    """What the sender calls them."""
    slot: int
    """The lowest number, from 0, that nobody else had when they came."""
    last_seen: float
    """When a frame with them came [s], of our own clock."""
    person: Person | None = None
    """Who follows them, from their first frame on."""
    stamps: Stamps = field(default_factory=Stamps)
    """Their time stamps."""
    waiting: Waiting | None = None
    """Their newest frame that has no pose yet."""


class Crowd:
    """Everybody who is there.

    The newest frame wins: where poses take longer than frames come, older frames are
    dropped and counted.

    Args:
        stature: What is known of people before they come.
        most: How many there may be.
        tally: What counts.
    """

    def __init__(self, stature: Stature, most: int, tally: Tally) -> None:
        self.stature = stature
        self._most, self._tally = most, tally
        self._here: dict[str, Presence] = {}

    def __len__(self) -> int:
        return len(self._here)

    @property
    def measuring(self) -> int:
        """How many are there and not measured yet."""
        people = [presence.person for presence in self._here.values()]
        return sum(person is None or person.body is None for person in people)

    def arrive(self, frame: Frame, now: float) -> list[SeenBody]:
        """Take in a frame.

        Args:
            frame: What a sensor saw.
            now: The time [s] of our own clock, which does not go back.

        Returns:
            Those whose frame is new and in order, for a recording.
        """
        self._tally.count(Event.FRAMES)
        new = []
        for seen in frame.bodies:
            presence = self._presence(seen, now)
            if presence is not None and self._take_in(presence, seen, frame.time, now):
                new.append(seen)
        return new

    def next(self) -> tuple[Presence, Waiting] | None:
        """Return who has waited longest, and no longer does; None: nobody."""
        waiting = [p for p in self._here.values() if p.waiting is not None]
        if not waiting:
            return None
        presence = min(waiting, key=lambda p: p.waiting.since if p.waiting else 0.0)
        frame, presence.waiting = presence.waiting, None
        return (presence, frame) if frame is not None else None

    def rest(self, now: float) -> list[Presence]:
        """Put to rest, and return, those who have not been seen for 2 s."""
        gone = [p for p in self._here.values() if now - p.last_seen > _GONE]
        for presence in gone:
            del self._here[presence.id]
            self._tally.count(Event.RESTED)
        return gone

    def _presence(self, seen: SeenBody, now: float) -> Presence | None:
        """Return whose frame it is, if there is room for them."""
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
        arrival, missing = presence.stamps.arrive(time)
        self._tally.count(Event.MISSING, missing)
        if arrival is Arrival.REPEATED:
            self._tally.count(Event.REPEATED)
            return False
        if arrival is Arrival.LATE:
            self._tally.count(Event.LATE)
            return False
        anew, since = arrival is Arrival.ANEW, now
        if anew:
            self._tally.count(Event.RESTARTED)
        if presence.waiting is not None:
            self._tally.count(Event.DROPPED)
            anew |= presence.waiting.anew
            since = presence.waiting.since
        presence.waiting = Waiting(seen, time, now, since, anew)
        return True
