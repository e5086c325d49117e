"""A live session: frames in, poses out, until it is stopped."""

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import (
    TRACKINGS,
    InputError,
    State,
    skeleton_named,
    standard_body,
)
from kinefilter.characters.arrays import shown
from kinefilter.characters.humanoid import MOST_CHARACTERS
from kinefilter.pipeline.physics.shared_scene import SharedScene

from .background import meanwhile
from .crowd import Crowd, PendingFrame, Person, Presence
from .endpoints import Address, find_endpoints
from .live_config import AccessConfig, LiveConfig
from .messages import (
    Command,
    Frame,
    LivePose,
    MalformedError,
    Place,
    Push,
    Reason,
    SeenBody,
    Throw,
    parse_message,
    props_line,
    scene_line,
    skeleton_line,
)
from .recorder import Recorder
from .sinks import Broadcast, Engine, open_sink
from .sources import Intake, open_source
from .tally import Event, Tally

if TYPE_CHECKING:
    from .sensors import Sensors, Stream

_TICK = 0.25  # s between checks for people who have left
_FLUSH = 1.0  # s between writes of the recording: as much is lost if it is killed
_WARM_UP = 45  # frames: a second to measure somebody, then poses
_MOST_BODIES = 32
_QUIET = 3  # iterations of the event loop that a WebSocket message takes to arrive


class Session:
    """Follows the people in one or more streams of frames.

    Poses are computed in the event loop itself, because waking a thread for each takes
    milliseconds on a busy machine. Between two poses, all frames that have arrived are
    taken in; if poses fall behind, each person's newest frame waits and older ones are
    dropped. If they are ``shown``, by whoever draws the ``scene``, there need not be
    anywhere that they go. Raises InputError if the configuration is wrong or a package
    is missing.
    """

    def __init__(
        self,
        config: LiveConfig,
        access: AccessConfig | None = None,
        *,
        shown: bool = False,
    ) -> None:
        self.tally = Tally()
        self.recorded: list[Path] = []  # files, once the recording is finished
        access = access or AccessConfig()
        self.endpoints = find_endpoints(config, access, shown=shown)
        most = _MOST_BODIES if config.scene is None else MOST_CHARACTERS
        if not 1 <= config.bodies <= most:
            raise InputError(f"--bodies {config.bodies}: expected 1 to {most}")
        self._config, self._skeleton = config, skeleton_named(config.skeleton)
        self.scene = self._new_scene()
        self._told_of = self.scene and self.scene.people
        self.crowd = Crowd(config.bodies, self.tally)
        count = len(self.endpoints.sources)
        self.sensors: Sensors | None = None
        self._new_person: Callable[[str], Person] = partial(Person, config, self.scene)
        if count > 1:
            from kinefilter.pipeline.merge import read_calibration
            from kinefilter.pipeline.merge.alignment import check_sensors

            from .fusing import FusedPerson
            from .sensors import Sensors

            check_sensors(known := read_calibration(config.calibration), count)
            self.sensors = Sensors(self._skeleton, count, known, self.tally)
            self._new_person = partial(FusedPerson, config, self.sensors, self.scene)
        elif config.calibration is not None:
            raise InputError("--calibration is for several --in; leave it out")
        self.recorders: list[Recorder] = []
        if (path := config.record) is not None:
            for k in range(1, count + 1):
                own = path.with_stem(f"{path.stem}.sensor{k}") if count > 1 else path
                self.recorders.append(Recorder(own, self._skeleton, self.tally))
        self._sinks: list[Broadcast | Engine] = []
        self._came, self._idle = asyncio.Event(), asyncio.Event()
        self._idle.set()

    def _new_scene(self) -> SharedScene | None:
        if self._config.scene is None:
            return None
        return SharedScene(self._config.scene, TRACKINGS[self._config.tracking])

    @property
    def failure(self) -> str | None:
        """Why a recording ended early, None if none did."""
        return next((r.failure for r in self.recorders if r.failure), None)

    async def run(
        self,
        stop: asyncio.Event,
        started: Callable[[list[Address]], None] = lambda _: None,
    ) -> None:
        """Follow people until ``stop`` is set or the input ends; finish the recording.

        ``started`` is called with the addresses in use, inputs before outputs. Raises
        InputError if a port is taken or a host is unknown.
        """
        access, used = self.endpoints.access, []
        try:
            self._warm_up()
            async with AsyncExitStack() as stack:
                for target in self.endpoints.targets:
                    intake = Intake(self.command, self._done, stop.set, self.tally)
                    opening = open_sink(target, access, self._greeting, intake)
                    sink, place = await stack.enter_async_context(opening)
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
        """Take in a message from a sensor; count it if it is invalid."""
        with self._counted():
            found = parse_message(message, self._skeleton)
            if isinstance(found, Frame):
                self._take_in(found, number)
            else:
                self._obey(found)

    def command(self, message: bytes | str) -> None:
        """Obey a message from a reader of poses; count it if it is no command."""
        with self._counted():
            found = parse_message(message, self._skeleton)
            if isinstance(found, Frame):
                raise MalformedError(Reason.COMMAND)
            self._obey(found)

    @contextmanager
    def _counted(self) -> Iterator[None]:
        try:
            yield
        except MalformedError as error:
            self.tally.malformed[error.reason] += 1
            if error.note:
                self.tally.notes.setdefault(error.reason, (error.note,))

    def _obey(self, command: Command) -> None:
        done, scene = False, self.scene
        if isinstance(command, Push):
            avatar = self.crowd.avatar(command.body)
            with suppress(InputError):  # no such joint, or not in the scene yet
                if avatar is not None:
                    avatar.push(command.joint, command.force, float(command.seconds))
                    done = True
        elif scene is not None and isinstance(command, Throw):
            if done := scene.has_world:
                scene.throw(*command)
        elif scene is not None and isinstance(command, Place):
            with suppress(InputError):  # a rotation of zero
                done = scene.place(*command)
        if not done:
            names = ", ".join(shown(value) for value in command if type(value) is str)
            note = f"a {type(command).__name__.lower()} names {names}"
            if scene is None and not isinstance(command, Push):
                note = "throws and places need --scene"
            elif isinstance(command, Throw):
                note = "nobody has come yet; throw once there is somebody"
            raise MalformedError(Reason.UNKNOWN, note)
        self.tally.events[Event.OBEYED] += 1

    def _take_in(self, frame: Frame, number: int) -> None:
        now = time.perf_counter()
        self.tally.events[Event.FRAMES] += 1
        if self.sensors is None or self.sensors.arrive(number, frame, now):
            new = self.crowd.arrive(frame, now)
            pending = bool(new)
        else:
            stream = self.sensors.streams[number]
            kept = stream.heard == now  # neither late nor repeated
            new = list(stream.frames[-1].bodies) if kept else []
            pending = self._hand_over(self.sensors, stream, now)
        for seen in new if self.recorders else ():
            self.recorders[number].add(frame.time, seen)
        if pending:
            self._idle.clear()
            self._came.set()

    def _hand_over(self, sensors: Sensors, stream: Stream, now: float) -> bool:
        """Follow people whom the leading sensor lost with another that sees them."""
        pending = False
        lost = self.crowd.lost_by_lead(now) if stream in sensors.joined else []
        for presence in lost:
            frame, person = stream.frames[-1], presence.person
            found = person and sensors.match(stream, frame, person)
            if found and stream.clock and stream.placed:
                positions = stream.placed.apply(found.positions)
                seen = SeenBody(presence.id, positions, found.state, True)
                self.crowd.add(seen, stream.clock.inverse(frame.time), now)
                pending = True
        return pending

    async def _done(self) -> None:
        await self._idle.wait()
        for sink in self._sinks:
            await sink.flushed()

    async def _pump(self) -> None:
        """Make poses, each of the person who has waited longest, or in a scene of all.

        People in a scene move at the same time.
        """
        while True:
            await self._came.wait()
            self._came.clear()
            while (turn := self.crowd.next()) is not None:
                turns = [turn]
                while self.scene is not None and (turn := self.crowd.next()):
                    turns.append(turn)
                self._pose(*turns)
                await self._let_others_run()
            self._idle.set()

    async def _let_others_run(self) -> None:
        """Send poses, and take in the frames that arrived during the last one."""
        quiet = 0
        while quiet < _QUIET:
            self._came.clear()
            await asyncio.sleep(0)
            quiet = 0 if self._came.is_set() else quiet + 1

    def _pose(self, *turns: tuple[Presence, PendingFrame]) -> None:
        posed = [turn for turn in turns if self._follow(*turn)]
        if self.scene is not None:
            try:
                self.scene.advance()
            except (InputError, ArithmeticError, ValueError):
                for presence, _ in posed:
                    self._start_over(presence)
                posed = []
            self._tell_who_is_there()
        for presence, frame in posed:
            self._send(presence, frame)
        if posed and self.scene is not None and (moved := self.scene.moved()):
            self._tell(props_line(posed[-1][1].time, moved))

    def _follow(self, presence: Presence, frame: PendingFrame) -> bool:
        """Follow a person; return whether there is a pose."""
        if presence.person is None:
            presence.person = self._new_person(presence.id)
        person, avatar = presence.person, presence.avatar
        turn = avatar and avatar.turn
        if frame.restarted:
            person.start()
        try:
            pose = person.step(frame.seen, frame.time)
        except (InputError, ArithmeticError, ValueError):
            # Inhuman lengths or an overflow: others must be able to carry on.
            self._start_over(presence)
            return False
        if person.avatar is not None and person.avatar.turn is not turn:
            self.tally.notes[presence.slot] = person.avatar.turn.notes()
        return pose is not None

    def _start_over(self, presence: Presence) -> None:
        if presence.person is not None:
            presence.person.leave()
        presence.person = None
        self.tally.events[Event.FAILED] += 1

    def _send(self, presence: Presence, frame: PendingFrame) -> None:
        avatar = presence.avatar
        assert avatar is not None
        pose, latency = avatar.pose, time.perf_counter() - frame.arrived
        named = presence.id, presence.slot, frame.time, avatar.body
        live = LivePose(*named, pose, latency)
        if self.scene is not None:
            live = live._replace(contacts=avatar.contacts, holds=avatar.holds)
        for sink in self._sinks:
            sink.send(live)
        self.tally.events[Event.POSES] += 1
        self.tally.events[Event.DIVERGED] += int(pose.reset)
        self.tally.events[Event.IMPOSSIBLE] += int(pose.impossible)
        self.tally.latency.add(time.perf_counter() - frame.arrived)

    def _greeting(self) -> list[str]:
        """Return the lines that every reader gets first."""
        lines = [skeleton_line(self._skeleton)]
        if self.scene is not None and self.scene.has_world:
            lines.append(self._scene_line())
        return lines

    def _scene_line(self) -> str:
        assert self.scene is not None
        return scene_line(str(self.scene.scene), self.scene.props)

    def _tell_who_is_there(self) -> None:
        """Describe the scene if anybody has joined or left it since the last time."""
        if self.scene is not None and self.scene.people is not self._told_of:
            self._told_of = self.scene.people
            self._tell(self._scene_line())

    def _tell(self, line: str) -> None:
        for sink in self._sinks:
            sink.put(line)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(_TICK)
            if self.sensors is not None:
                self.sensors.update_notes(time.perf_counter())
            for gone in self.crowd.drop_gone(time.perf_counter()):
                if gone.person is not None:
                    gone.person.leave()
                for sink in self._sinks:
                    sink.gone(gone)
            self._tell_who_is_there()

    async def _record(self) -> None:
        while True:
            await asyncio.sleep(_FLUSH)
            for recorder in self.recorders:
                await asyncio.to_thread(recorder.flush)

    def _warm_up(self) -> None:
        """Load what the first poses need, and exempt it from garbage collection."""
        scene = self._new_scene()
        person, rest = Person(self._config, scene), standard_body(self._skeleton)
        tracked = np.full(len(self._skeleton), State.TRACKED)
        for k in range(_WARM_UP):
            person.step(SeenBody("", rest.rest_positions, tracked), k / 30.0)
            if scene is not None:
                scene.advance()
        gc.collect()
        gc.freeze()
