"""A live session: frames in, poses out, until it is stopped."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from kinefilter.characters import (
    STANDARD_HEIGHT,
    InputError,
    Skeleton,
    skeleton_named,
    standard_body,
)
from kinefilter.pipeline.avatar import Avatar

from .background import meanwhile
from .config import AccessConfig, LiveConfig
from .crowd import Crowd, Person, Presence, Waiting
from .endpoints import Address, find_endpoints
from .messages import LivePose, MalformedError, parse_frame
from .recorder import Recorder
from .sinks import Broadcast, Engine, open_sink
from .sources import Intake, open_source
from .tally import Event, Tally

if TYPE_CHECKING:
    from .sensors import Sensors, Stream

_TICK = 0.25  # s between checks of who is gone
_FLUSH = 1.0  # s between writes of the recording: what a kill may cost
_WARM_UP = 10  # frames; the first of a process take a hundred times as long
_MOST_BODIES = 32
_QUIET = 3  # turns of the loop: a WebSocket's message takes as many to get here
_Started = Callable[[list[Address]], None]


class Session:
    """Follows the people of a stream.

    Poses are made in the loop itself: to wake a thread for each takes a busy machine
    some milliseconds. Between two poses all frames that came are taken in; while poses
    are late, the newest frame of each person waits and older ones are dropped. Raises
    InputError if the configuration is wrong, or a package is not installed.
    """

    def __init__(self, config: LiveConfig, access: AccessConfig | None = None) -> None:
        self.tally = Tally()
        self.recorded: list[Path] = []  # once the recording is finished
        self.endpoints = find_endpoints(config, access or AccessConfig())
        if not 1 <= config.bodies <= _MOST_BODIES:
            raise InputError(f"--bodies {config.bodies}: expected 1 to {_MOST_BODIES}")
        self._config, self._skeleton = config, skeleton_named(config.skeleton)
        self.crowd = Crowd(config.bodies, self.tally)
        count = len(self.endpoints.sources)
        self.sensors = _sensors(config, self._skeleton, self.tally)
        self.recorders: list[Recorder] = []
        if (path := config.record) is not None:
            paths = [path]
            if count > 1:
                stems = (f"{path.stem}.sensor{k}" for k in range(1, count + 1))
                paths = [path.with_stem(stem) for stem in stems]
            self.recorders = [
                Recorder(path, self._skeleton, self.tally) for path in paths
            ]
        self._sinks: list[Broadcast | Engine] = []
        self._came, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()

    @property
    def failure(self) -> str | None:
        """Why a recording ended, if it did."""
        return next((r.failure for r in self.recorders if r.failure), None)

    async def run(
        self, stop: asyncio.Event, started: _Started = lambda _: None
    ) -> None:
        """Follow people until ``stop`` is set or the input ends; end the recording.

        ``started`` is called with the addresses in use, of inputs, then of outputs.
        Raises InputError if a port is taken, or a host not known.
        """
        access, used = self.endpoints.access, []
        try:
            self._warm_up()
            async with AsyncExitStack() as stack:
                for target in self.endpoints.targets:
                    sink, place = await stack.enter_async_context(
                        open_sink(target, access, self._skeleton, self.tally, stop.set)
                    )
                    self._sinks.append(sink)
                    used.append(place)
                work = [self._pump(), self._tick(), self._record(), stop.wait()]
                if self.sensors is not None:
                    work.append(self.sensors.follow())
                tasks = await stack.enter_async_context(meanwhile(*work))
                async with AsyncExitStack() as inputs:
                    places = []
                    for number, source in enumerate(self.endpoints.sources):
                        receive = partial(self.receive, number=number)
                        intake = Intake(receive, self._done, stop.set, self.tally)
                        opened = open_source(source, access, intake)
                        places.append(await inputs.enter_async_context(opened))
                    started([*places, *used])
                    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in tasks:
                    if task.done():
                        task.result()
                await self._idle.wait()
        finally:
            gc.unfreeze()
            for recorder in self.recorders:
                self.recorded += recorder.finish()

    def receive(self, message: bytes | str, number: int = 0) -> None:
        """Take in a message of a sensor; one that is not a frame is counted."""
        try:
            frame = parse_frame(message, self._skeleton, self._config.bodies)
        except MalformedError as error:
            self.tally.malformed[error.reason] += 1
            return
        now = time.perf_counter()
        self.tally.count(Event.FRAMES)
        if self.sensors is None or self.sensors.arrive(number, frame, now):
            new = self.crowd.arrive(frame, now)
            waits = bool(new)
        else:
            stream = self.sensors.streams[number]
            kept = stream.heard == now  # neither late nor repeated
            new = list(stream.frames[-1].bodies) if kept else []
            waits = self._carry(self.sensors, stream, now)
        for seen in new:
            if self.recorders:
                self.recorders[number].add(frame.time, seen)
        if waits:
            self._idle.clear()
            self._came.set()

    def _carry(self, sensors: Sensors, stream: Stream, now: float) -> bool:
        """Follow people whom the leading sensor does not see by one that does."""
        waits = False
        for presence in self.crowd.unseen(now) if stream in sensors.joined else []:
            frame, person = stream.frames[-1], presence.person
            found = person and sensors.match(stream, frame, person)
            if found and stream.clock is not None:
                seen, places = found
                seen = replace(seen, id=presence.id, positions=places, carried=True)
                self.crowd.take_in(seen, stream.clock.undone(frame.time), now)
                waits = True
        return waits

    async def _done(self) -> None:
        await self._idle.wait()
        for sink in self._sinks:
            await sink.flushed()

    async def _pump(self) -> None:
        """Make poses, always of the person who has waited longest."""
        while True:
            await self._came.wait()
            self._came.clear()
            while (turn := self.crowd.next()) is not None:
                self._pose(*turn)
                await self._take_in()
            self._idle.set()

    async def _take_in(self) -> None:
        """Send poses, and take in frames that arrived during the last pose."""
        quiet = 0
        while quiet < _QUIET:
            self._came.clear()
            await asyncio.sleep(0)
            quiet = 0 if self._came.is_set() else quiet + 1

    def _pose(self, presence: Presence, waiting: Waiting) -> None:
        """Make a person's pose and send it."""
        if presence.person is None:
            presence.person = self._person()
        person, turn = presence.person, presence.person.turn
        if waiting.restarted:
            person.start()
        try:
            pose = person.step(waiting.seen, waiting.time)
        except (InputError, ArithmeticError, ValueError):
            # Measures of no human, or an overflow: one person's frames must not end
            # the session of the others.
            presence.person = None
            self.tally.count(Event.FAILED)
            return
        if pose is None or person.body is None:
            return
        if person.turn is not None and person.turn is not turn:
            self.tally.notes[presence.slot] = person.turn.told()
        latency = time.perf_counter() - waiting.arrived
        named = presence.id, presence.slot, waiting.time
        live = LivePose(*named, person.body, pose, latency)
        for sink in self._sinks:
            sink.send(live)
        self.tally.count(Event.POSES)
        self.tally.count(Event.DIVERGED, int(pose.reset))
        self.tally.count(Event.IMPOSSIBLE, int(pose.impossible))
        self.tally.latency.add(time.perf_counter() - waiting.arrived)

    def _person(self) -> Person:
        if self.sensors is None:
            return Person(self._config)
        from .fusing import FusedPerson

        return FusedPerson(self._config, self.sensors)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(_TICK)
            if self.sensors is not None:
                self.sensors.tell(time.perf_counter())
            for gone in self.crowd.drop_gone(time.perf_counter()):
                for sink in self._sinks:
                    sink.gone(gone)

    async def _record(self) -> None:
        while True:
            await asyncio.sleep(_FLUSH)
            for recorder in self.recorders:
                await asyncio.to_thread(recorder.flush)

    def _warm_up(self) -> None:
        """Load what the first pose needs, and exempt it from garbage collection."""
        config = self._config
        height = STANDARD_HEIGHT if config.height is None else config.height
        body = standard_body(self._skeleton, height=height, mass=config.mass)
        avatar = Avatar(body, config.scene, floor=config.floor)
        for k in range(_WARM_UP):
            avatar.step(body.rest_positions, k / 30.0)
        gc.collect()
        gc.freeze()


def _sensors(config: LiveConfig, skeleton: Skeleton, tally: Tally) -> Sensors | None:
    """Return the sensors, None for one; raises InputError for a wrong calibration."""
    count = len(config.sources)
    if count == 1:
        if config.calibration is not None:
            raise InputError("--calibration is for several --in; leave it out")
        return None
    from kinefilter.pipeline.merge import read_calibration

    from .sensors import Sensors

    known = read_calibration(config.calibration)
    if known and len(known) != count - 1:
        raise InputError(
            f"the calibration is of {len(known) + 1} sensors, and {count} --in are "
            "given; give them in its order"
        )
    return Sensors(skeleton, count, known, tally)
