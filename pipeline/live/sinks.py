"""Where poses go: readers of WebSockets, an engine, the standard output."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from kinefilter.characters import Skeleton

from .endpoints import STANDARD, Access, Address, Datagrams, open_datagrams, open_server
from .messages import LivePose, gone_line, pose_line, skeleton_line
from .tally import Event, Tally
from .vmc import VmcFigure, absence

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_STDOUT = 1
_WAITING = 32  # lines that wait for a reader: a second of one person; poses get old
_DEAD = 10.0  # s after which a client that reads nothing is closed; it may come again
_SENT_AHEAD = 2**17  # bytes that the system keeps for a slow reader, two seconds of one
_LARGEST_ASKED = 2**10  # bytes: readers have nothing to say
_GOODBYE = 1.0  # s for the last lines


class Sink:
    """Where poses go."""

    def send(self, live: LivePose) -> None:
        """Send a pose, without waiting for readers."""
        self.put(pose_line(live))

    def gone(self, body: str, slot: int) -> None:
        """Tell that a person is gone."""
        del slot  # which VMC alone knows people by
        self.put(gone_line(body))

    def put(self, line: str) -> None:
        """Send a line."""

    async def flushed(self) -> None:
        """Wait for readers; of those that come and go as they like, for none."""


@asynccontextmanager
async def open_sink(
    address: Address,
    access: Access,
    skeleton: Skeleton,
    tally: Tally,
    lost: Callable[[], None],
) -> AsyncIterator[tuple[Sink, Address]]:
    """Yield what poses are sent to, and its address in use.

    Raises InputError if the port is taken or the host not known.
    """
    if address.scheme == STANDARD:
        printer = _Printer(skeleton, tally, lost)
        try:
            yield printer, address
        finally:
            await printer.finish()
    elif address.scheme == "vmc":
        with open_datagrams(address) as out:
            yield _Engine(out, tally), address
    else:
        lines = Broadcast(skeleton, tally)
        async with open_server(
            lines.handle, address, access, tally, largest=_LARGEST_ASKED
        ) as actual:
            yield lines, actual


class _Engine(Sink):
    """Sends each person to a port of their own: the first to PORT, the next to PORT+1.

    Datagrams that no engine listens for are lost; it goes on with the next pose.
    """

    def __init__(self, out: Datagrams, tally: Tally) -> None:
        self._out, self._tally = out, tally
        self._figures: dict[int, VmcFigure] = {}
        self._since: float | None = None

    def send(self, live: LivePose) -> None:
        figure = self._figures.get(live.slot)
        if figure is None or figure.body is not live.body:
            figure = self._figures[live.slot] = VmcFigure(live.body)
        if self._since is None:
            self._since = live.time
        for datagram in figure.bundles(live.pose, live.time - self._since):
            self._send(live.slot, datagram)

    def gone(self, body: str, slot: int) -> None:
        del body
        self._send(slot, absence())

    def _send(self, slot: int, datagram: bytes) -> None:
        if not self._out(datagram, slot):
            self._tally.count(Event.UNSENT)


class Broadcast(Sink):
    """Sends lines to all readers of a WebSocket; a slow reader loses the oldest."""

    def __init__(self, skeleton: Skeleton, tally: Tally) -> None:
        self._first, self._tally = skeleton_line(skeleton), tally
        self.readers: set[_Reader] = set()  # who is connected

    def put(self, line: str) -> None:
        """Give a line to all readers."""
        for reader in self.readers:
            if len(reader.lines) == _WAITING:
                self._tally.count(Event.SLOW)
            reader.lines.append(line)
            reader.wake.set()

    async def handle(self, connection: ServerConnection) -> None:
        """Serve a reader until it goes."""
        from websockets.exceptions import ConnectionClosed

        out = connection.transport.get_extra_info("socket")
        out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SENT_AHEAD)
        reader = _Reader()
        closed = asyncio.ensure_future(connection.wait_closed())
        closed.add_done_callback(lambda _: reader.wake.set())
        self.readers.add(reader)
        try:
            with contextlib.suppress(ConnectionClosed):
                await connection.send(self._first)
                while not closed.done():
                    await reader.wake.wait()
                    reader.wake.clear()
                    while reader.lines:
                        async with asyncio.timeout(_DEAD):
                            await connection.send(reader.lines.popleft())
        except TimeoutError:
            connection.transport.abort()
        finally:
            self.readers.discard(reader)
            closed.cancel()


class _Reader:
    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=_WAITING)
        self.wake = asyncio.Event()


class _Printer(Sink):
    """Prints lines; if they are not read for long, the oldest are lost and counted."""

    def __init__(
        self, skeleton: Skeleton, tally: Tally, lost: Callable[[], None]
    ) -> None:
        self._tally, self._lost = tally, lost
        self._loop = asyncio.get_running_loop()
        self._change = threading.Condition()
        self._lines: deque[str] = deque()
        self._busy, self._over = False, False
        self._idle = asyncio.Event()
        first = skeleton_line(skeleton)
        # A daemon: a write to a pipe that is not read never ends.
        threading.Thread(target=self._write, args=(first,), daemon=True).start()

    async def flushed(self) -> None:
        await self._idle.wait()

    async def finish(self) -> None:
        """Wait a moment for the last lines."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._idle.wait(), _GOODBYE)
        with self._change:
            self._over = True
            self._change.notify()

    def put(self, line: str) -> None:
        with self._change:
            if len(self._lines) == _WAITING:
                self._lines.popleft()
                self._tally.count(Event.SLOW)
            self._lines.append(line)
            self._idle.clear()
            self._change.notify()

    def _write(self, text: str) -> None:
        try:
            while True:
                write_out(f"{text}\n".encode())
                with self._change:
                    self._busy = False
                    if not self._lines:
                        self._loop.call_soon_threadsafe(self._settle)
                    self._change.wait_for(lambda: self._lines or self._over)
                    if self._over:
                        return
                    text, self._busy = "\n".join(self._lines), True
                    self._lines.clear()
        except OSError:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._closed)
        except RuntimeError:
            return  # the loop is closed

    def _settle(self) -> None:
        with self._change:
            if not self._lines and not self._busy:
                self._idle.set()

    def _closed(self) -> None:
        self._idle.set()
        self._lost()


def write_out(data: bytes) -> None:
    """Write to the standard output and wait; raises OSError if nobody reads it."""
    # To the descriptor: a buffer's lock would outlive the interpreter.
    while data:
        data = data[os.write(_STDOUT, data) :]
