"""The sensors of a session: where and when each sees what the first one does.

``merge`` finds it from the frames of the last half minute, again and again while people
are followed, in a process of its own, as it takes a second. Two answers in a row have
to agree before anything is fused. A clock that jumps is set by when its frames come.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import takewhile
from weakref import WeakSet

import numpy as np

from kinefilter.characters import InputError, Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.merge import Alignment, merge
from kinefilter.pipeline.merge.lag import Clock
from kinefilter.pipeline.merge.person import moved
from kinefilter.pipeline.merge.rigid import Placement
from kinefilter.pipeline.workers import Worker

from .crowd import Person
from .messages import Frame, SeenBody, stacked
from .tally import Tally

OLDEST = 0.15  # s: what a sensor saw before tells nothing more of where a joint is

_NEAR = 1.0 / 60.0  # s: half a frame later is nearer than one that is older
_KEPT, _MOST = 30.0, 2000  # s, and frames, from which places and clocks are found
_LEAST, _FEWEST = 5.0, 50  # of them that it takes
_AGAIN, _LATER = 2.0, 10.0  # s between answers until a sensor is placed, and after that
_POLLED = 0.05  # s
_PATIENCE = 20.0  # s of frames after which it is told that streams do not fit
_LAG = 0.05  # s between answers that agree. A guess
_COPIED = 1e-3  # m: nearer to each other are only the joints of one stream given twice
_DARK = 2.0  # s without anybody
_JUMP = 1.0  # s by which a clock runs ahead of ours where it was set
_RESTARTED = 2.0  # s back that are no frame out of order
_TIMED = 15  # frames that tell by how much a clock differs from ours
_SAME = 0.6  # m between a person's joints as two sensors see them, on average. A guess.


class Stream:
    """What came from one sensor."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.frames: deque[Frame] = deque(maxlen=_MOST)
        self.offsets: deque[float] = deque(maxlen=4 * _TIMED)  # our clock less its [s]
        self.heard = self.seen = -np.inf  # when a frame, and one with a person, came
        self.placed: Placement | None = None  # into the first sensor's frame
        self.clock: Clock | None = None  # its time at times of the first one's
        self.late: float | None = None
        """By how much its frames come after those of the first one [s]."""
        self.path = 0.0  # m that people went while it was placed
        self.answer: Alignment | None = None  # the last one
        self.note = ""

    def arrive(self, frame: Frame, now: float) -> bool:
        """Keep who is in a frame that came now [s]; return whether its clock jumped."""
        jumped = False
        if self.frames:
            step = frame.time - self.frames[-1].time
            if -_RESTARTED <= step <= 0.0:
                return False  # late or repeated
            jumped = step < 0.0 or step - (now - self.heard) > _JUMP
        if jumped:
            self.frames.clear()
            self.offsets.clear()
        bodies = tuple(body for body in frame.bodies if body.is_seen)
        self.heard, self.seen = now, now if bodies else self.seen
        self.frames.append(Frame(frame.time, bodies))
        self.offsets.append(now - frame.time)
        while self.frames[0].time < frame.time - _KEPT:
            self.frames.popleft()
        return jumped

    def until(self, time: float, after: float) -> list[Frame]:
        """Return the frames of the last moments before a time [s], and at it."""
        oldest = max(after, time - OLDEST)
        newest = takewhile(lambda f: f.time > oldest, reversed(self.frames))
        return [frame for frame in newest if frame.time <= time + _NEAR][::-1]

    def recording(self, skeleton: Skeleton) -> Recording | None:
        """Return the frames as takes, None where there are too few."""
        rows = defaultdict(list)
        for frame in self.frames:
            for seen in frame.bodies:
                rows[seen.id].append((frame.time, seen))
        takes = tuple(
            Take(*stacked(body), skeleton, self.name)
            for body in rows.values()
            if len(body) >= _FEWEST and body[-1][0] - body[0][0] >= _LEAST
        )
        return Recording(takes, self.name) if takes else None

    @property
    def offset(self) -> float:
        """Our clock less the sensor's, and the least that frames take to come [s]."""
        return min(self.offsets)


class Sensors:
    """The streams of a session, of which one leads.

    Poses are at its frames, in its frame. It is the first one, unless that shows nobody
    for 2 s and another one does. A calibration says where all but the first are; the
    tally is told how they are.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        count: int,
        calibration: Sequence[Alignment],
        tally: Tally,
    ) -> None:
        self._skeleton, self.tally = skeleton, tally
        self.streams = [Stream(f"sensor {k}") for k in range(1, count + 1)]
        for stream, known in zip(self.streams[1:], calibration, strict=False):
            stream.placed, stream.path = known.placed, known.path
        self.lead: Stream | None = None
        self.followed: WeakSet[Person] = WeakSet()
        self._began = np.inf

    def arrive(self, number: int, frame: Frame, now: float) -> bool:
        """Take in a sensor's frame that came now [s]; return whether that one leads."""
        stream = self.streams[number]
        jumped = stream.arrive(frame, now)
        if self.lead is None and stream.seen == now:
            self._began = min(self._began, now)
            if number == 0 or now - self._began > _DARK:
                self.lead = stream
                if number:  # a calibration is of where others are from the first
                    for other in self.streams:
                        other.placed = None
        for other in self.others:
            if jumped and stream in (other, self.lead):
                other.clock = other.answer = None
            if other.clock is None and other.late is not None:
                self._set(other, other.late)
        return stream is self.lead

    @property
    def others(self) -> list[Stream]:
        """All but the one that leads."""
        return [s for s in self.streams if self.lead not in (None, s)]

    @property
    def joined(self) -> list[Stream]:
        """Those of which it is known where and when they see people."""
        return [s for s in self.others if s.placed is not None and s.clock is not None]

    def match(
        self, stream: Stream, frame: Frame, person: Person
    ) -> tuple[SeenBody, Array] | None:
        """Return who in a sensor's frame is a person, and the joints in our frame [m].

        The nearest, unless they are nearer to somebody else.
        """
        assert stream.placed is not None
        if person.place is None:
            return None
        others = [p.place for p in self.followed if p is not person]
        best, least = None, _SAME
        for seen in frame.bodies:
            positions = stream.placed.apply(seen.positions)
            place = np.nanmean(positions, axis=0)
            away = float(np.linalg.norm(place - person.place))
            rivals = [np.linalg.norm(place - p) for p in others if p is not None]
            if away < least and all(away <= rival for rival in rivals):
                best, least = (seen, positions), away
        return best

    async def follow(self) -> None:
        """Find where and when sensors see what the leading one does, for ever."""
        worker = Worker()
        try:
            while True:
                for stream in self.others:
                    asked = (one for one in (self.lead, stream) if one is not None)
                    given = [one.recording(self._skeleton) for one in asked]
                    if None in given:
                        continue
                    try:
                        # In a thread, as the process may still be starting.
                        await asyncio.to_thread(worker.call, find, given)
                        self._judge(stream, await _answered(worker))
                    except (EOFError, OSError):  # it was killed
                        worker = Worker()
                ready = self.others and len(self.joined) == len(self.others)
                await asyncio.sleep(_LATER if ready else _AGAIN)
        finally:
            worker.end()

    def tell(self, now: float) -> None:
        """Note how the sensors are, now [s]."""
        for number, stream in enumerate(self.streams, 1):
            self.tally.notes[-number] = tuple(self._told(stream, now))

    def _told(self, stream: Stream, now: float) -> Iterator[str]:
        others = [s for s in self.streams if s is not stream]
        if all(now - other.seen > _DARK for other in others):
            return
        if now - stream.heard > _DARK:
            yield f"{stream.name} sends nothing"
        elif now - stream.seen > _DARK:
            yield f"{stream.name} sees nobody"
        elif self.lead not in (None, stream):
            if stream.note:
                yield stream.note
            elif stream.clock is None:
                yield (
                    f"{stream.name}: looking for where it stands; it takes somebody "
                    "who walks to and fro in view of all sensors"
                )

    def _judge(self, stream: Stream, found: Alignment | str) -> None:
        """Take an answer that agrees with the last one."""
        lead = self.lead
        assert lead is not None
        if isinstance(found, str):
            stream.answer = None
            length = stream.frames[-1].time - stream.frames[0].time
            if stream.clock is None and length >= _PATIENCE:
                stream.note = f"{stream.name} is not fused: {found}"
            return
        if found.place_is_sure:
            placed = found.placed
        elif stream.placed is not None and found.clock_is_sure:
            placed = stream.placed
        else:
            return
        now, found = lead.frames[-1].time, found._replace(placed=placed)
        last, stream.answer = stream.answer, found
        if last is None or moved(last.placed, found.placed):
            return
        if abs(last.clock.at(now) - found.clock.at(now)) >= _LAG:
            return
        stands = stream.placed is None or not moved(stream.placed, found.placed)
        known = stream.clock is not None and stands
        if not stands or found.path >= stream.path:  # the farther they went, the surer
            stream.placed, stream.path = found.placed, found.path
        stream.clock = found.clock
        stream.late = found.clock.at(now) - now - lead.offset + stream.offset
        if not known:
            stream.note = _joined(stream, lead)

    def _set(self, stream: Stream, late: float) -> None:
        """Set a clock by how late frames came before it jumped [s]."""
        lead = self.lead
        if lead is None or min(len(lead.offsets), len(stream.offsets)) < _TIMED:
            return
        time = lead.frames[-1].time
        stream.clock = Clock(time, time + (late + lead.offset - stream.offset))
        stream.note = f"{_joined(stream, lead)}, after a clock jumped"


def find(recordings: Sequence[Recording]) -> Alignment | str:
    """Return when and where a second sensor recorded what a first did, or why not."""
    with suppress(ArithmeticError, ValueError, np.linalg.LinAlgError):
        try:
            (found,) = merge(recordings).alignments
        except InputError as refused:
            reason = str(refused).rpartition(": ")[2]
            return f"{reason.partition(';')[0]} as {recordings[0].takes[0].source}"
        if found.apart < _COPIED:
            return f"it is the stream of {recordings[0].takes[0].source} once more"
        return found
    return "its frames make no sense"


async def _answered(worker: Worker) -> Alignment | str:
    """Return what a process found; raises EOFError or OSError if it was killed."""
    while True:
        while not worker.calls.poll():
            await asyncio.sleep(_POLLED)
        found: Alignment | str | bool = worker.calls.recv()
        if not isinstance(found, bool):  # True, when it began
            return found


def _joined(stream: Stream, lead: Stream) -> str:
    assert stream.placed is not None
    assert stream.late is not None
    x, _, z = stream.placed.turn.apply([0.0, 0.0, 1.0])
    away, late = np.linalg.norm(stream.placed.shift), 1e3 * stream.late
    told = (
        f"{stream.name} joined: {np.degrees(np.arctan2(x, z)):.0f} degrees, "
        f"{away:.1f} m away, frames {abs(late):.0f} ms "
        f"{'later' if late > 0.0 else 'earlier'} than those of {lead.name}"
    )
    if stream.late > OLDEST:
        told += ", too late to be fused; name the slowest sensor first"
    return told
