"""The people in view, how each is followed, and whose frame gets the next pose."""

from collections import deque
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Body, State, Take, skeleton_named, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.avatar import Avatar, Pose
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.factory import make_corrector
from kinefilter.pipeline.formats.recording import LONGEST_STEP
from kinefilter.pipeline.physics.shared_scene import SharedScene

from .live_config import LiveConfig
from .messages import Frame, Reason, SeenBody, as_arrays
from .tally import Event, Tally

_LOST_BY_LEAD = 0.12  # s without the leading sensor until other sensors' frames count
_GONE = 2.0  # s unseen after which a person is dropped
RESTARTED = 2.0  # s: a stamp earlier by more than this means the clock restarted
_EXCHANGED = 0.5  # m that two people are nearer to each other's last place: a guess
_RECENT = 0.5  # s for which a place counts
_STEPS = 15  # steps whose median is the sender's usual one: half a second
_LONGEST_GAP = 2.0  # s: the person was away for longer ones, and no frame is missing
MEASURED_FOR = 1.0
"""Seconds in which a person is measured: segment lengths of recorded takes then differ
by 7 mm on average from those of the whole take; after 3 s, by 5 mm."""
_ENOUGH = 15  # good frames within that time
_LONGEST = 3.0  # s after which a person is measured even if half hidden
_MAX_FRAMES = 120  # kept while measuring, whatever the frame rate
_WELL_SEEN = 0.8  # share of joints tracked in a good frame. A guess.


class Person:
    """Follows one person, with a standard body if the configuration has a height.

    Otherwise the person is measured first, and poses begin after about a second. With a
    ``scene``, its ``advance`` completes them, and ``name`` is as for an ``Avatar``.
    """

    place: Array | None = None  # mean joint [m], shape (3,); only with several sensors

    def __init__(
        self, config: LiveConfig, scene: SharedScene | None = None, name: str = ""
    ) -> None:
        self._config, self._skeleton = config, skeleton_named(config.skeleton)
        self._scene, self._name = scene, name
        self.avatar: Avatar | None = None  # None before the person is measured
        self._frames: list[tuple[float, SeenBody]] = []
        if (height := config.height) is not None:
            body = standard_body(self._skeleton, height=height, mass=config.mass)
            self.avatar = self._make_avatar(body)

    def start(self) -> None:
        """Start over, because the sender's clock restarted."""
        self._frames.clear()
        if self.avatar is not None:
            self.avatar.start()

    def leave(self) -> None:
        """Leave the scene."""
        if self.avatar is not None:
            self.avatar.leave()

    def step(self, seen: SeenBody, time: float) -> Pose | None:
        """Return the pose after a frame at ``time`` [s], None while still measuring."""
        if self.avatar is not None:
            return self.avatar.step(seen.positions, time, seen.state)
        if len(self._frames) < _MAX_FRAMES:
            self._frames.append((time, seen))
        good = [
            (stamp, body)
            for stamp, body in self._frames
            if (body.state == State.TRACKED).mean() >= _WELL_SEEN
        ]
        enough = len(good) >= _ENOUGH and good[-1][0] - good[0][0] >= MEASURED_FOR
        if enough or time - self._frames[0][0] >= _LONGEST:
            frames = as_arrays(good if enough else self._frames)
            take = Take(*frames, self._skeleton, "live")
            config = self._config
            cleaner = Cleaner(CleanConfig(mass=config.mass, method=config.method))
            self.avatar = self._make_avatar(*cleaner.measure(take))
            self._frames.clear()
        return None

    def _make_avatar(self, body: Body, measured: Body | None = None) -> Avatar:
        config = self._config
        return Avatar(
            body,
            self._scene,
            floor=config.floor,
            tracking=config.tracking,
            corrector=make_corrector(self._skeleton, CleanConfig(method=config.method)),
            measured=measured,
            name=self._name,
        )


class Stamps:
    """Checks the time stamps of one person's frames, in the order of arrival."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._steps: deque[float] = deque(maxlen=_STEPS)

    @property
    def usual_step(self) -> float:
        """The sender's usual step [s]; 0 before there are enough."""
        return float(np.median(self._steps)) if len(self._steps) == _STEPS else 0.0

    def arrive(self, time: float) -> tuple[Event | None, int]:
        """Return whether a stamp [s] is out of order, and how many frames are missing.

        The event is REPEATED, LATE, RESTARTED if the clock has restarted, or None.
        Missing frames are counted as usual steps since the last stamp.
        """
        last, self._last = self._last, time
        if last is None:
            return None, 0
        step = time - last
        if step < -RESTARTED:
            self._steps.clear()
            return Event.RESTARTED, 0
        if step <= 0.0:
            self._last = last
            return (Event.LATE if step < 0.0 else Event.REPEATED), 0
        missing = 0
        if (usual := self.usual_step) and step < _LONGEST_GAP:
            missing = max(0, round(step / usual) - 1)
        self._steps.append(step)
        return None, missing


class PendingFrame(NamedTuple):
    """A person's frame that waits for its pose; times are of our own clock."""

    seen: SeenBody
    time: float  # the frame's time stamp [s], of the sensor's clock
    arrived: float  # when it arrived [s]
    since: float  # since when the person has been waiting for a pose [s]
    restarted: bool  # the sender's clock restarted since the last pose


@dataclass(eq=False)
class Presence:
    """A person in front of the sensor; times are of our own clock."""

    id: str  # the sender's name for the person
    slot: int  # the lowest number, from 0, that was free when the person appeared
    last_seen: float  # when a frame with the person arrived [s]
    place: Array  # of the person then [m], shape (3,)
    person: Person | None = None  # from the first pose on
    seen_by_lead: float = 0.0  # when the leading sensor last saw the person [s]
    stamps: Stamps = field(default_factory=Stamps)
    pending: PendingFrame | None = None  # the newest frame without a pose

    @property
    def avatar(self) -> Avatar | None:
        """The person's character, None before the first pose."""
        return None if self.person is None else self.person.avatar


class Crowd:
    """All people in view; a newer frame of a person replaces one without a pose."""

    def __init__(self, most: int, tally: Tally) -> None:
        self._most, self._tally = most, tally
        self._here: dict[str, Presence] = {}
        self._names: dict[str, str] = {}  # who has an id that was another's before

    def __len__(self) -> int:
        return len(self._here)

    @property
    def measuring(self) -> int:
        """Number of people who are not measured yet."""
        return sum(presence.avatar is None for presence in self._here.values())

    def avatar(self, name: str) -> Avatar | None:
        """Return the character of a person, by the sender's name, if there is one."""
        return self._here[name].avatar if name in self._here else None

    def arrive(self, frame: Frame, now: float) -> list[SeenBody]:
        """Add a frame that arrived now [s]; return the bodies that ``add`` accepts.

        Two people whose ids a tracker exchanges, as when they meet, keep their names.
        """
        names = self._names
        bodies = [
            replace(seen, id=names.get(seen.id, seen.id)) for seen in frame.bodies
        ]
        for a, b in combinations(range(len(bodies)), 2):
            if self._are_exchanged(bodies[a], bodies[b], now):
                bodies[a], bodies[b] = (
                    replace(bodies[k], id=bodies[other].id)
                    for k, other in ((a, b), (b, a))
                )
                self._tally.events[Event.EXCHANGED] += 1
                for k in (a, b):
                    names[frame.bodies[k].id] = bodies[k].id
        return [seen for seen in bodies if self.add(seen, frame.time, now)]

    def _are_exchanged(self, one: SeenBody, other: SeenBody, now: float) -> bool:
        """Return True if both are where the other one was a moment ago."""
        if not (one.is_seen and other.is_seen):
            return False
        before = [self._here.get(seen.id) for seen in (one, other)]
        places = [
            presence.place
            for presence in before
            if presence is not None and now - presence.last_seen < _RECENT
        ]
        if len(places) < 2:
            return False
        here = np.array([one.place, other.place])
        apart = np.linalg.norm(here[:, None] - np.array(places), axis=2)
        stayed, exchanged = apart.diagonal().max(), apart[::-1].diagonal().max()
        return bool(exchanged < stayed - _EXCHANGED)

    def lost_by_lead(self, now: float) -> list[Presence]:
        """Return the people whom the leading sensor has not seen for some frames."""
        return [p for p in self._here.values() if now - p.seen_by_lead > _LOST_BY_LEAD]

    def next(self) -> tuple[Presence, PendingFrame] | None:
        """Remove and return the frame of whoever has waited longest, if any."""
        pending = [(p, p.pending) for p in self._here.values() if p.pending is not None]
        if not pending:
            return None
        presence, frame = min(pending, key=lambda pair: pair[1].since)
        presence.pending = None
        return presence, frame

    def drop_gone(self, now: float) -> list[Presence]:
        """Drop, and return, the people who have not been seen for 2 s."""
        gone = [p for p in self._here.values() if now - p.last_seen > _GONE]
        for presence in gone:
            del self._here[presence.id]
            self._tally.events[Event.RESTED] += 1
        if not self._here:
            self._names.clear()
        return gone

    def add(self, seen: SeenBody, time: float, now: float) -> bool:
        """Keep a person's frame; return True if there is room and it is in order."""
        if not seen.is_seen:
            self._tally.events[Event.UNSEEN] += 1
            return False
        if seen.id not in self._here:
            free = set(range(self._most)) - {p.slot for p in self._here.values()}
            if not free:
                self._tally.events[Event.CROWDED] += 1
                return False
            self._here[seen.id] = Presence(seen.id, min(free), now, seen.place)
        presence = self._here[seen.id]
        presence.last_seen, presence.place = now, seen.place
        if not seen.from_other_sensor:
            presence.seen_by_lead = now
        event, missing = presence.stamps.arrive(time)
        self._tally.events[Event.MISSING] += missing
        if (step := presence.stamps.usual_step) > LONGEST_STEP:
            note = (
                f"by their stamps, frames are {step:.4g} s apart: send times in seconds"
            )
            self._tally.notes.setdefault(Reason.TIME, (note,))
        if event is not None:
            self._tally.events[event] += 1
        if event in (Event.REPEATED, Event.LATE):
            return False
        restarted, since = event is Event.RESTARTED, now
        if (older := presence.pending) is not None:
            self._tally.events[Event.DROPPED] += 1
            restarted |= older.restarted
            since = older.since
        presence.pending = PendingFrame(seen, time, now, since, restarted)
        return True
