"""Where messages come from: datagrams, WebSockets, the standard input."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import CancelledError
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kinefilter.characters import InputError

from .access import Access
from .addresses import STANDARD, Address
from .limits import LARGEST_MESSAGE, Peers, Rate
from .messages import Reason
from .tally import Event, Tally
from .websocket import open_server

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_STDIN = 0
_CHUNK = 2**16  # bytes


@dataclass(frozen=True)
class Intake:
    """What is done with messages."""

    receive: Callable[[bytes | str], None]
    """Takes a message."""
    done: Callable[[], Awaitable[None]]
    """Waits until all that was taken has its pose."""
    ended: Callable[[], None]
    """Told when nothing more can come."""
    tally: Tally
    """What counts messages that are not taken."""


@asynccontextmanager
async def open_source(
    address: Address, access: Access, intake: Intake
) -> AsyncIterator[Address]:
    """Hand over the messages that come to an address; yields the address in use.

    Args:
        address: Of the scheme udp, ws, wss or ``-``; port 0 takes a free one.
        access: Who may connect by WebSocket.
        intake: What is done with messages.

    Raises:
        InputError: The port is taken or the host not ours.
    """
    if address.scheme == STANDARD:
        _Stdin(intake).start()
        yield address
    elif address.scheme == "udp":
        async with _datagrams(address, intake) as actual:
            yield actual
    else:
        handler = _handler(intake)
        async with open_server(
            handler, address, access, intake.tally, largest=LARGEST_MESSAGE
        ) as actual:
            yield actual


class Receiver(asyncio.DatagramProtocol):
    """Hands over the datagrams of a few senders, each up to a rate."""

    def __init__(self, intake: Intake) -> None:
        self._intake, self._peers = intake, Peers()

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Take a datagram."""
        now = time.perf_counter()
        rate = self._peers.rate(addr, now)
        if rate is None:
            self._intake.tally.count(Event.REFUSED)
        elif not rate.allows(now):
            self._intake.tally.count(Event.TOO_FAST)
        else:
            self._intake.receive(data)


@asynccontextmanager
async def _datagrams(address: Address, intake: Intake) -> AsyncIterator[Address]:
    loop = asyncio.get_running_loop()
    try:
        transport, _ = await loop.create_datagram_endpoint(
            lambda: Receiver(intake), local_addr=(address.host, address.port)
        )
    except OSError as error:
        raise InputError(
            f"{address}: cannot listen there ({error.strerror or error}); "
            "choose another port or address"
        ) from None
    try:
        port = int(transport.get_extra_info("sockname")[1])
        yield Address("udp", address.host, port)
    finally:
        transport.close()


def _handler(intake: Intake) -> Callable[[ServerConnection], Awaitable[None]]:
    """Return what takes the messages of one connection."""
    from websockets.exceptions import ConnectionClosedError
    from websockets.frames import CloseCode

    async def handle(connection: ServerConnection) -> None:
        rate = Rate(time.perf_counter())
        try:
            async for message in connection:
                if rate.allows(time.perf_counter()):
                    intake.receive(message)
                else:
                    intake.tally.count(Event.TOO_FAST)
        except ConnectionClosedError as error:
            sent = error.sent
            if sent is not None and sent.code == CloseCode.MESSAGE_TOO_BIG:
                intake.tally.malformed[Reason.TOO_LONG] += 1

    return handle


class _Stdin:
    """Lines of the standard input, each of which waits for the poses of the last.

    Whoever writes into a pipe can wait, so no frame is dropped.
    """

    def __init__(self, intake: Intake) -> None:
        self._intake = intake
        self._loop = asyncio.get_running_loop()

    def start(self) -> None:
        # A daemon: nothing ends a read for which nobody writes.
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        # From the descriptor: a buffer's lock would outlive the interpreter.
        rest, too_long = b"", False
        while chunk := os.read(_STDIN, _CHUNK):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                if not self._take(b"" if too_long else line, too_long):
                    return
                too_long = False
            if len(rest) > LARGEST_MESSAGE:
                rest, too_long = b"", True
        if rest.strip() or too_long:
            self._take(rest, too_long)
        self._call(self._ended())

    def _take(self, line: bytes, too_long: bool) -> bool:
        return self._call(self._handed(line, too_long))

    def _call(self, work: Any) -> bool:
        """Run something in the loop and wait for it; tell whether it could."""
        try:
            asyncio.run_coroutine_threadsafe(work, self._loop).result()
        except (RuntimeError, CancelledError):  # the loop is closed, or closing
            work.close()
            return False
        return True

    async def _handed(self, line: bytes, too_long: bool) -> None:
        if too_long:
            self._intake.tally.malformed[Reason.TOO_LONG] += 1
        elif line.strip():
            self._intake.receive(line)
            await self._intake.done()

    async def _ended(self) -> None:
        self._intake.ended()
