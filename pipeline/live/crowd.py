"""The people who are there, how each is followed, and whose frame waits for its pose.

A person is measured first, then followed by a character.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from kinefilter.characters import Body, State, Take, skeleton_named, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.reliability import measure_body
from kinefilter.pipeline.target.upright import Turn

from .config import LiveConfig
from .messages import Frame, SeenBody, stacked
from .tally import Event, Tally

_UNSEEN = 0.12  # s after which another sensor's frames count for those that lead
_GONE = 2.0  # s unseen after which a person is dropped
_RESTARTED = 2.0  # s before the last stamp: the sender's clock restarted
_STEPS = 15  # steps of which the median is the sender's: half a second
_LONGEST_GAP = 2.0  # s: after that the person was gone, and no frame is missing
_MEASURED_FOR = 1.0
"""Time [s] that a person is measured for. In recorded takes segment lengths are then on
average 7 mm from those of the whole take, after 3 s 5 mm."""
_ENOUGH = 15  # good frames in it
_LONGEST = 3.0  # s; a person half hidden for that long is measured all the same
_MOST_FRAMES = 120  # kept meanwhile, whatever the rate
_WELL_SEEN = 0.8  # share of joints tracked in a good frame. A guess.


class Person:
    """Follows one person.

    With a height the standard body of that height is followed from the first frame.
    Without, the person's segments are measured in the first second or so, and poses
    begin after it.
    """

    place: Array | None = None
    """The mean of the joints that were seen last [m], where several sensors may see the
    person, shape (3,)."""

    def __init__(self, config: LiveConfig) -> None:
        self._config, self._skeleton = config, skeleton_named(config.skeleton)
        self._avatar: Avatar | None = None
        self._frames: list[tuple[float, SeenBody]] = []
        if config.height is not None:
            height, mass = config.height, config.mass
            body = standard_body(self._skeleton, height=height, mass=mass)
            self._avatar = self._follow(body)

    @property
    def body(self) -> Body | None:
        """The person's body, None before it is measured."""
        return None if self._avatar is None else self._avatar.body

    @property
    def turn(self) -> Turn | None:
        """How the sensor's frame is turned for this person; None: nobody knows yet."""
        return None if self._avatar is None else self._avatar.turn

    def start(self) -> None:
        """Start over, as the sender's clock does."""
        self._frames.clear()
        if self._avatar is not None:
            self._avatar.start()

    def step(self, seen: SeenBody, time: float) -> Pose | None:
        """Return the pose after a frame, None while the person is measured.

        ``time`` is the frame's stamp [s], later than the last.
        """
        if self._avatar is not None:
            return self._avatar.step(seen.positions, time, seen.state)
        if len(self._frames) < _MOST_FRAMES:
            self._frames.append((time, seen))
        good = [
            (stamp, body)
            for stamp, body in self._frames
            if (body.state == State.TRACKED).mean() >= _WELL_SEEN
        ]
        enough = len(good) >= _ENOUGH and good[-1][0] - good[0][0] >= _MEASURED_FOR
        if enough or time - self._frames[0][0] >= _LONGEST:
            frames = stacked(good if enough else self._frames)
            take = Take(*frames, self._skeleton, "live")
            body = measure_body(take, mass=self._config.mass)
            self._avatar = self._follow(body)
            self._frames.clear()
        return None

    def _follow(self, body: Body) -> Avatar:
        config = self._config
        return Avatar(body, config.scene, floor=config.floor, tracking=config.tracking)


class Stamps:
    """The time stamps of one person's frames, in whatever order they come."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._steps: deque[float] = deque(maxlen=_STEPS)

    def arrive(self, time: float) -> tuple[Event | None, int]:
        """Take the sensor's stamp [s] of a frame.

        Returns whether it is REPEATED, LATE or the first of a clock that RESTARTED, or
        None if it is in order; and how many frames seem to be missing before it: by how
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
    led: float = 0.0  # when the leading sensor last saw the person [s], of our clock
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
        people = (presence.person for presence in self._here.values())
        return sum(person is None or person.body is None for person in people)

    def arrive(self, frame: Frame, now: float) -> list[SeenBody]:
        """Take in a frame that came now [s], of our own clock, which only goes on.

        Returns the bodies whose frame is new and in order, for a recording.
        """
        return [seen for seen in frame.bodies if self.take_in(seen, frame.time, now)]

    def unseen(self, now: float) -> list[Presence]:
        """Return those whom the leading sensor has not seen for some frames."""
        return [p for p in self._here.values() if now - p.led > _UNSEEN]

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

    def take_in(self, seen: SeenBody, time: float, now: float) -> bool:
        """Keep a person's frame; tell whether there is room, and it is in order."""
        if not seen.is_seen:
            self._tally.count(Event.UNSEEN)
            return False
        if seen.id not in self._here:
            if len(self._here) >= self._most:
                self._tally.count(Event.CROWDED)
                return False
            taken = {presence.slot for presence in self._here.values()}
            slot = min(set(range(self._most)) - taken)
            self._here[seen.id] = Presence(seen.id, slot, now)
        presence = self._here[seen.id]
        presence.last_seen = now
        presence.led = presence.led if seen.carried else now
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
