"""Every pose for everybody who connected by WebSocket."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections import deque
from typing import TYPE_CHECKING

from kinefilter.characters import Skeleton

from .poses import LivePose, gone_line, pose_line, skeleton_line
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_WAITING = 32  # lines that wait for a reader: a second of one person; poses get old
_DEAD = 10.0  # s: who reads nothing for as long makes room, and may come again
_SENT_AHEAD = 2**17  # bytes that the system keeps for a slow reader, two seconds of one


class Broadcast:
    """Sends lines to all readers; whoever is slow loses the oldest.

    Args:
        skeleton: The joints of poses.
        tally: What counts lost lines.
    """

    def __init__(self, skeleton: Skeleton, tally: Tally) -> None:
        self._first, self._tally = skeleton_line(skeleton), tally
        self.readers: set[_Reader] = set()
        """Who is connected."""

    def send(self, live: LivePose) -> None:
        """Give a pose to all readers."""
        self.give(pose_line(live))

    def gone(self, body: str, slot: int) -> None:  # noqa: ARG002 - as all sinks
        """Tell all readers that somebody is gone."""
        self.give(gone_line(body))

    async def flushed(self) -> None:
        """Do not wait: readers come and go as they like."""

    def give(self, line: str) -> None:
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
    """What waits for somebody who reads."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque(maxlen=_WAITING)
        self.wake = asyncio.Event()
