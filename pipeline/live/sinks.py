"""Where poses go: readers of WebSockets, an engine, the standard output."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from kinefilter.characters import Skeleton

from .background import meanwhile, write_out
from .crowd import Presence
from .endpoints import STANDARD, Access, Address, Datagrams, open_datagrams, open_server
from .messages import LivePose, gone_line, pose_line, skeleton_line
from .tally import Event, Tally
from .vmc import VmcFigure, absence

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_WAITING = 32  # lines that wait for a reader: a second of one person; poses get old
_DEAD = 10.0  # s after which a client that reads nothing is closed; it may come again
_SENT_AHEAD = 2**17  # bytes that the system keeps for a slow reader, two seconds of one
_LARGEST_ASKED = 2**10  # bytes: readers have nothing to say
_GOODBYE = 1.0  # s for the last lines


@asynccontextmanager
async def open_sink(
    address: Address,
    access: Access,
    skeleton: Skeleton,
    tally: Tally,
    lost: Callable[[], None],
) -> AsyncIterator[tuple[Broadcast | Engine, Address]]:
    """Yield what poses are sent to, and its address in use.

    Raises InputError if the port is taken or the host not known.
    """
    if address.scheme == STANDARD:
        lines = Broadcast(skeleton, tally, waited_for=True)
        printing = lines.serve(lambda line: write_out(f"{line}\n"))
        async with meanwhile(printing) as (task,):
            task.add_done_callback(lambda _: lost())
            await asyncio.sleep(0)  # it begins
            try:
                yield lines, address
            finally:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(lines.flushed(), _GOODBYE)
    elif address.scheme == "vmc":
        with open_datagrams(address) as out:
            yield Engine(out, tally), address
    else:
        lines = Broadcast(skeleton, tally)
        async with open_server(
            lines.handle, address, access, tally, largest=_LARGEST_ASKED
        ) as actual:
            yield lines, actual


class Engine:
    """Sends each person to a port of their own: the first to PORT, the next to PORT+1.

    Datagrams that no engine listens for are lost; it goes on with the next pose.
    """

    def __init__(self, out: Datagrams, tally: Tally) -> None:
        self._out, self._tally = out, tally
        self._figures: dict[int, VmcFigure] = {}
        self._since: float | None = None

    def send(self, live: LivePose) -> None:
        """Send a pose."""
        figure = self._figures.get(live.slot)
        if figure is None or figure.body is not live.body:
            figure = self._figures[live.slot] = VmcFigure(live.body)
        if self._since is None:
            self._since = live.time
        for datagram in figure.bundles(live.pose, live.time - self._since):
            self._send(live.slot, datagram)

    def gone(self, person: Presence) -> None:
        """Tell that a person is gone."""
        self._send(person.slot, absence())

    async def flushed(self) -> None:
        """Wait for nobody: an engine may not even be there."""

    def _send(self, slot: int, datagram: bytes) -> None:
        if not self._out(datagram, slot):
            self._tally.count(Event.UNSENT)


class Broadcast:
    """Sends lines to all readers; a slow reader loses the oldest, which is counted."""

    def __init__(
        self, skeleton: Skeleton, tally: Tally, *, waited_for: bool = False
    ) -> None:
        self._first, self._tally = skeleton_line(skeleton), tally
        self._waited_for = waited_for  # whether the input waits for readers
        self.readers: set[Reader] = set()

    def send(self, live: LivePose) -> None:
        """Send a pose, without waiting for readers."""
        self.put(pose_line(live))

    def gone(self, person: Presence) -> None:
        """Tell that a person is gone."""
        self.put(gone_line(person.id))

    def put(self, line: str) -> None:
        """Give a line to all readers."""
        for reader in self.readers:
            if len(reader.lines) == _WAITING:
                self._tally.count(Event.SLOW)
            reader.lines.append(line)
            reader.idle.clear()
            reader.came.set()

    async def flushed(self) -> None:
        """Wait until readers have every line, where they are waited for."""
        for reader in list(self.readers) if self._waited_for else ():
            await reader.idle.wait()

    async def serve(self, write: Callable[[str], Awaitable[None]]) -> None:
        """Let a new reader have all lines from now on, by what writes one for it."""
        reader = Reader()
        self.readers.add(reader)
        try:
            await write(self._first)
            while True:
                while reader.lines:
                    await write(reader.lines.popleft())
                reader.idle.set()
                await reader.came.wait()
                reader.came.clear()
        finally:
            reader.idle.set()
            self.readers.discard(reader)

    async def handle(self, connection: ServerConnection) -> None:
        """Serve a reader of a WebSocket until it goes."""
        from websockets.exceptions import ConnectionClosed

        async def write(line: str) -> None:
            async with asyncio.timeout(_DEAD):
                await connection.send(line)

        out = connection.transport.get_extra_info("socket")
        out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SENT_AHEAD)
        try:
            async with meanwhile(self.serve(write), connection.wait_closed()) as tasks:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                if tasks[0].done():
                    tasks[0].result()
        except ConnectionClosed:
            pass
        except TimeoutError:
            connection.transport.abort()


class Reader:
    """Lines that wait for a reader."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=_WAITING)
        self.came, self.idle = asyncio.Event(), asyncio.Event()
