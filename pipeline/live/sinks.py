"""Destinations of poses: WebSocket readers, engines, and standard output."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from enum import Enum, auto
from typing import TYPE_CHECKING

from .background import meanwhile, write_stdout
from .crowd import Presence
from .endpoints import (
    ENGINES,
    STANDARD,
    Access,
    Address,
    Datagrams,
    open_datagrams,
    open_server,
)
from .messages import LivePose, gone_line, pose_line
from .sources import Intake, take_all
from .tally import Event, Tally
from .vmc import VmcFigure, absence
from .vrchat import VrchatFigure

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_MAX_WAITING = 32  # lines that wait for a reader: one second of one person
_DEAD = 10.0  # s after which a client that reads nothing is closed; it may reconnect
_SEND_BUFFER = 2**17  # bytes that the system buffers for a reader: two seconds
_MAX_REQUEST = 2**10  # bytes: fits any command
_GOODBYE = 1.0  # s for the last lines


@asynccontextmanager
async def open_sink(
    address: Address, access: Access, greeting: Callable[[], list[str]], intake: Intake
) -> AsyncIterator[tuple[Broadcast | Engine, Address]]:
    """Yield a destination for poses, and its address in use.

    Readers of lines get those of the ``greeting`` first. The intake takes what readers
    send, and is told if the reader of standard output has ended. Raises InputError if
    the port is taken or the host is unknown.
    """
    tally = intake.tally
    if address.scheme == STANDARD:
        lines = Broadcast(greeting, intake, waited_for=True)
        printing = lines.serve(lambda line: write_stdout(f"{line}\n"))
        async with meanwhile(printing) as (task,):
            task.add_done_callback(lambda _: intake.ended())
            await asyncio.sleep(0)  # lets it start
            try:
                yield lines, address
            finally:
                with suppress(TimeoutError):
                    await asyncio.wait_for(lines.flushed(), _GOODBYE)
    elif address.scheme in ENGINES:
        with open_datagrams(address) as out:
            yield Engine(out, tally, address.scheme), address
    else:
        lines = Broadcast(greeting, intake)
        async with open_server(
            lines.handle, address, access, tally, largest=_MAX_REQUEST
        ) as actual:
            yield lines, actual


class Engine:
    """Sends each person to a port of their own: PORT, PORT+1 and so on."""

    def __init__(self, out: Datagrams, tally: Tally, scheme: str) -> None:
        self._out, self._tally = out, tally
        self._vrchat = scheme == "vrchat"
        self._figures: dict[int, VmcFigure | VrchatFigure] = {}
        self._first: float | None = None  # time stamp of the first pose [s]

    def send(self, live: LivePose) -> None:
        """Send a pose."""
        figure = self._figures.get(live.slot)
        if figure is None or figure.body is not live.body:
            figure = (VrchatFigure if self._vrchat else VmcFigure)(live.body)
            self._figures[live.slot] = figure
        if self._first is None:
            self._first = live.time
        for datagram in figure.bundles(live.pose, live.time - self._first):
            self._send(live.slot, datagram)

    def gone(self, person: Presence) -> None:
        """Report that a person has left."""
        if not self._vrchat:  # where trackers that are not sent vanish
            self._send(person.slot, absence())

    def put(self, line: str) -> None:
        """Ignore a line about the scene: engines have no messages for props."""

    async def flushed(self) -> None:
        """Return at once: there may be no engine to wait for."""

    def _send(self, slot: int, datagram: bytes) -> None:
        if not self._out(datagram, slot):
            self._tally.events[Event.UNSENT] += 1


class Kind(Enum):
    """What a line is about, which decides whether a slow reader may lose it."""

    POSE = auto()  # may be lost: another one follows
    SCENE = auto()  # the scene or its props: a new description of the scene replaces it
    OTHER = auto()  # comes once, such as that a person has left


_Lines = asyncio.Queue[tuple[Kind, str] | None]  # None ends a reader


class Broadcast:
    """Sends lines to all readers; slow readers lose the oldest poses, as counted.

    Lines about the scene that a reader has not read when it is full are replaced by
    what the ``greeting`` says of it, after the first line. A reader that leaves too
    many other lines unread is ended: it may connect again.
    """

    def __init__(
        self,
        greeting: Callable[[], list[str]],
        intake: Intake,
        *,
        waited_for: bool = False,
    ) -> None:
        self._greeting, self._intake, self._tally = greeting, intake, intake.tally
        self._waited_for = waited_for  # the input waits for readers
        self.readers: set[_Lines] = set()  # lines that wait for each

    def send(self, live: LivePose) -> None:
        """Send a pose, without waiting for readers."""
        self.put(pose_line(live), Kind.POSE)

    def gone(self, person: Presence) -> None:
        """Report that a person has left."""
        self.put(gone_line(person.id), Kind.OTHER)

    def put(self, line: str, kind: Kind = Kind.SCENE) -> None:
        """Queue a line for all readers."""
        for lines in list(self.readers):
            if lines.qsize() < _MAX_WAITING or self._make_room(lines, kind):
                lines.put_nowait((kind, line))

    def _make_room(self, lines: _Lines, kind: Kind) -> bool:
        """Make room for another line in a full queue; return whether there is."""
        waiting = [lines.get_nowait() for _ in range(lines.qsize())]
        kinds, room = [item[0] for item in waiting if item], True
        if Kind.POSE in kinds:
            del waiting[kinds.index(Kind.POSE)]
            self._tally.events[Event.SLOW] += 1
        elif kinds.count(Kind.SCENE) > 1:
            waiting = [item for item in waiting if item and item[0] is not Kind.SCENE]
            waiting += [(Kind.SCENE, now) for now in self._greeting()[1:]]
        else:
            room = False
            self._tally.events[Event.SLOW] += 1
            if kind is not Kind.POSE:
                self.readers.discard(lines)
                waiting = [None]
        for item in waiting:
            lines.put_nowait(item)
        for _ in kinds:  # only now, lest nothing seems to wait in between
            lines.task_done()
        return room

    async def flushed(self) -> None:
        """Wait until readers have every line, if the input waits for them."""
        for lines in list(self.readers) if self._waited_for else ():
            await lines.join()

    async def serve(self, write: Callable[[str], Awaitable[None]]) -> None:
        """Write all lines from now on for a new reader, by calling ``write``."""
        lines: _Lines = asyncio.Queue()
        for number, line in enumerate(self._greeting()):
            lines.put_nowait((Kind.SCENE if number else Kind.OTHER, line))
        self.readers.add(lines)
        try:
            while (item := await lines.get()) is not None:
                await write(item[1])
                lines.task_done()
        finally:
            self.readers.discard(lines)

    async def handle(self, connection: ServerConnection) -> None:
        """Serve a WebSocket reader until it disconnects."""
        from websockets.exceptions import ConnectionClosed

        async def write(line: str) -> None:
            async with asyncio.timeout(_DEAD):
                await connection.send(line)

        out = connection.transport.get_extra_info("socket")
        out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        try:
            async with meanwhile(
                self.serve(write), take_all(self._intake, connection)
            ) as tasks:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                if tasks[0].done():
                    tasks[0].result()
        except ConnectionClosed:
            pass
        except TimeoutError:
            connection.transport.abort()
