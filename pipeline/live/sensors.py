"""The sensors of a live session, and how their clocks and frames relate to the first.

``merge`` finds this from the frames of the last half minute, again and again while
people are followed; as it takes a second, it runs in a process of its own. Nothing is
fused before two answers in a row agree. If a clock jumps, it is set from the arrival
times of its frames.
"""

import asyncio
from collections import defaultdict, deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import takewhile
from weakref import WeakSet

import numpy as np

from kinefilter.characters import InputError, Skeleton, Take
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.merge import Alignment, merge
from kinefilter.pipeline.merge.lag import Clock
from kinefilter.pipeline.merge.person import displacement
from kinefilter.pipeline.merge.rigid import Placement
from kinefilter.pipeline.workers import ProcessDiedError, Workers

from .crowd import RESTARTED, Person
from .messages import Frame, SeenBody, as_arrays
from .tally import Tally

MAX_AGE = 0.15  # s; older frames of a sensor no longer show where a joint is

_NEAR = 1.0 / 60.0  # s: a frame half a step ahead is nearer than the one before
_KEPT, _MAX_FRAMES = 30.0, 2000  # s and frames that are kept to find places and clocks
_MIN_SECONDS, _MIN_FRAMES = 5.0, 50  # of them that it takes
_RETRY, _RECHECK = 2.0, 10.0  # s between answers, before and after all sensors joined
_PATIENCE = 20.0  # s of frames after which a note reports that streams do not fit
_LAG = 0.05  # s between answers that agree. A guess
_COPIED = 1e-3  # m: only joints of the same stream, given twice, are so close
_DARK = 2.0  # s without a person
_JUMP = 1.0  # s that a clock gains on ours if it was set
_TIMED = 15  # frames that it takes to compare a clock with ours
_SAME = 0.6  # m between one person's joints in two sensors, on average. A guess.


class Stream:
    """The frames of one sensor; the leading sensor is the reference."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.frames: deque[Frame] = deque(maxlen=_MAX_FRAMES)
        # Our clock minus the sensor's at arrivals [s]; the least has the least delay.
        self.offsets: deque[float] = deque(maxlen=4 * _TIMED)
        self.heard = self.seen = -np.inf  # arrival of the last frame, and with a person
        self.placed: Placement | None = None  # from its frame to the reference's
        self.clock: Clock | None = None  # its time at times of the reference
        self.late: float | None = None  # how much later than those its frames come [s]
        self.path = 0.0  # how far people had walked when it was placed [m]
        self.answer: Alignment | None = None  # the last one
        self.note = ""

    def arrive(self, frame: Frame, now: float) -> bool:
        """Keep a frame that arrived now [s]; return True if the clock jumped."""
        jumped = False
        if self.frames:
            step = frame.time - self.frames[-1].time
            if -RESTARTED <= step <= 0.0:
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

    def recent(self, time: float, after: float) -> list[Frame]:
        """Return the frames shortly before a time [s], if they are later than after."""
        oldest = max(after, time - MAX_AGE)
        newest = takewhile(lambda f: f.time > oldest, reversed(self.frames))
        return [frame for frame in newest if frame.time <= time + _NEAR][::-1]

    def recording(self, skeleton: Skeleton) -> Recording | None:
        """Return the frames as takes, None if there are too few."""
        rows = defaultdict(list)
        for frame in self.frames:
            for seen in frame.bodies:
                rows[seen.id].append((frame.time, seen))
        takes = tuple(
            Take(*as_arrays(body), skeleton, self.name)
            for body in rows.values()
            if len(body) >= _MIN_FRAMES and body[-1][0] - body[0][0] >= _MIN_SECONDS
        )
        return Recording(takes) if takes else None


class Sensors:
    """The streams of a session, of which one leads.

    Poses have its time stamps and frame. The first sensor leads, unless it sees no one
    for 2 s while another one does. A calibration places all sensors but the first.
    """

    def __init__(
        self, skeleton: Skeleton, count: int, known: Sequence[Alignment], tally: Tally
    ) -> None:
        self._skeleton, self.tally = skeleton, tally
        self.streams = [Stream(f"sensor {k}") for k in range(1, count + 1)]
        for stream, found in zip(self.streams[1:], known, strict=False):
            stream.placed, stream.path = found.placed, found.path
        self.lead: Stream | None = None
        self.others: list[Stream] = []  # all but the lead, once there is one
        self.people: WeakSet[Person] = WeakSet()
        self._began = np.inf

    def arrive(self, number: int, frame: Frame, now: float) -> bool:
        """Add a sensor's frame that arrived now [s]; return True if that one leads."""
        stream = self.streams[number]
        jumped = stream.arrive(frame, now)
        if self.lead is None and stream.seen == now:
            self._began = min(self._began, now)
            if number == 0 or now - self._began > _DARK:
                self.lead = stream
                self.others = [other for other in self.streams if other is not stream]
                if number:  # a calibration is relative to the first sensor
                    for other in self.streams:
                        other.placed = None
        for other in self.others:
            if jumped and stream in (other, self.lead):
                other.clock = other.answer = None
            if other.clock is None and other.late is not None:
                self._reset_clock(other, other.late)
        return stream is self.lead

    @property
    def joined(self) -> list[Stream]:
        """The other streams whose place and clock are known."""
        return [s for s in self.others if s.placed is not None and s.clock is not None]

    def match(self, stream: Stream, frame: Frame, person: Person) -> SeenBody | None:
        """Return the body nearest to a person, if near enough and no other's."""
        assert stream.placed is not None
        if person.place is None:
            return None
        others = [p.place for p in self.people if p is not person]
        best, least = None, _SAME
        for seen in frame.bodies:
            place = np.nanmean(stream.placed.apply(seen.positions), axis=0)
            away = float(np.linalg.norm(place - person.place))
            rivals = [np.linalg.norm(place - p) for p in others if p is not None]
            if away < least and all(away <= rival for rival in rivals):
                best, least = seen, away
        return best

    async def follow(self) -> None:
        """Keep finding the place and clock of all other sensors, until cancelled."""
        process = Workers(1)
        try:
            while True:
                for stream in self.others:
                    both = [one for one in (self.lead, stream) if one is not None]
                    found = (one.recording(self._skeleton) for one in both)
                    if len(pair := [one for one in found if one is not None]) < 2:
                        continue
                    answer = asyncio.wrap_future(process.submit(find_alignment, pair))
                    with suppress(ProcessDiedError):  # it was killed
                        self._consider(stream, await answer)
                ready = self.others and len(self.joined) == len(self.others)
                await asyncio.sleep(_RECHECK if ready else _RETRY)
        finally:
            process.end(0.0)

    def update_notes(self, now: float) -> None:
        """Update the tally's notes on the sensors, now [s]."""
        for number, stream in enumerate(self.streams, 1):
            note = self._note(stream, now)
            self.tally.notes[-number] = (note,) if note else ()

    def _note(self, stream: Stream, now: float) -> str:
        if all(now - s.seen > _DARK for s in self.streams if s is not stream):
            return ""
        if now - stream.heard > _DARK:
            return f"{stream.name} sends nothing"
        if now - stream.seen > _DARK:
            return f"{stream.name} sees no one"
        if stream not in self.others:
            return ""
        if stream.note or stream.clock is not None:
            return stream.note
        return (
            f"{stream.name}: finding where it stands; someone has to walk back and "
            "forth in view of all sensors"
        )

    def _consider(self, stream: Stream, found: Alignment | str) -> None:
        """Use an alignment if it agrees with the last one."""
        lead = self.lead
        assert lead is not None
        if isinstance(found, str):
            stream.answer = None
            length = stream.frames[-1].time - stream.frames[0].time
            if stream.clock is None and length >= _PATIENCE:
                stream.note = f"{stream.name} is not fused: {found}"
            return
        if not found.place_is_sure:
            if stream.placed is None or not found.clock_is_sure:
                return
            found = found._replace(placed=stream.placed)
        now, last, stream.answer = lead.frames[-1].time, stream.answer, found
        if last is None or displacement(last.placed, found.placed):
            return
        if abs(last.clock.at(now) - found.clock.at(now)) >= _LAG:
            return
        stands = stream.placed is None or not displacement(stream.placed, found.placed)
        known = stream.clock is not None and stands
        if not stands or found.path >= stream.path:  # a longer path is more certain
            stream.placed, stream.path = found.placed, found.path
        stream.clock = found.clock
        late = found.clock.at(now) - now
        stream.late = late - min(lead.offsets) + min(stream.offsets)
        if not known:
            stream.note = _joined_note(stream, lead)

    def _reset_clock(self, stream: Stream, late: float) -> None:
        """Set a clock that jumped by how late its frames arrived before [s]."""
        lead = self.lead
        if lead is None or min(len(lead.offsets), len(stream.offsets)) < _TIMED:
            return
        time = lead.frames[-1].time
        lag = late + min(lead.offsets) - min(stream.offsets)
        stream.clock = Clock(time, time + lag)
        stream.note = f"{_joined_note(stream, lead)}, after a clock jumped"


def find_alignment(recordings: Sequence[Recording]) -> Alignment | str:
    """Return the alignment of a second sensor to a first, or why there is none."""
    first = recordings[0].takes[0].source
    try:
        (found,) = merge(recordings).alignments
    except InputError as refused:
        reason, _, _ = str(refused).rpartition(": ")[2].partition(";")
        return f"{reason} (compared with {first})"
    except (ArithmeticError, ValueError):
        return "its frames cannot be aligned"
    copied = found.trunk_distance < _COPIED
    return f"it repeats the stream of {first}" if copied else found


def _joined_note(stream: Stream, lead: Stream) -> str:
    assert stream.placed is not None
    assert stream.late is not None
    x, _, z = stream.placed.turn.apply([0.0, 0.0, 1.0])
    away, late = np.linalg.norm(stream.placed.shift), 1e3 * stream.late
    note = (
        f"{stream.name} joined: {np.degrees(np.arctan2(x, z)):.0f} degrees, "
        f"{away:.1f} m away, frames {abs(late):.0f} ms "
        f"{'later' if late > 0.0 else 'earlier'} than those of {lead.name}"
    )
    if stream.late > MAX_AGE:
        note += ", too late to be fused; name the slowest sensor first"
    return note
