"""A live session: frames in, poses out, until it is stopped."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path

from kinefilter.characters import (
    STANDARD_HEIGHT,
    InputError,
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
        self.recorder: Recorder | None = None
        if config.record is not None:
            self.recorder = Recorder(config.record, self._skeleton, self.tally)
        self._sinks: list[Broadcast | Engine] = []
        self._came, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()

    async def run(
        self, stop: asyncio.Event, started: _Started = lambda _: None
    ) -> None:
        """Follow people until ``stop`` is set or the input ends; end the recording.

        ``started`` is called with the addresses in use, of the input, then the outputs.
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
                work = (self._pump(), self._tick(), self._record(), stop.wait())
                tasks = await stack.enter_async_context(meanwhile(*work))
                intake = Intake(self.receive, self._done, stop.set, self.tally)
                async with open_source(self.endpoints.source, access, intake) as place:
                    started([place, *used])
                    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in tasks:
                    if task.done():
                        task.result()
                await self._idle.wait()
        finally:
            gc.unfreeze()
            if self.recorder is not None:
                self.recorded = self.recorder.finish()

    def receive(self, message: bytes | str) -> None:
        """Take in a message; one that is not a frame is counted."""
        try:
            frame = parse_frame(message, self._skeleton, self._config.bodies)
        except MalformedError as error:
            self.tally.malformed[error.reason] += 1
            return
        for seen in self.crowd.arrive(frame, time.perf_counter()):
            if self.recorder is not None:
                self.recorder.add(frame.time, seen)
            self._idle.clear()
            self._came.set()

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
            presence.person = Person(self._config)
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

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(_TICK)
            for gone in self.crowd.drop_gone(time.perf_counter()):
                for sink in self._sinks:
                    sink.gone(gone.id, gone.slot)

    async def _record(self) -> None:
        while True:
            await asyncio.sleep(_FLUSH)
            if self.recorder is not None:
                await asyncio.to_thread(self.recorder.flush)

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
