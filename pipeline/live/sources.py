"""Where messages come from: datagrams, WebSockets, the standard input."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Hashable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from .background import meanwhile, read_in
from .endpoints import (
    MOST_CONNECTIONS,
    STANDARD,
    Access,
    Address,
    cannot_listen,
    open_server,
)
from .messages import LARGEST_MESSAGE, Reason
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_RATE = 240.0  # messages a second from one sender: eight times a Kinect's
_BURST = 60.0  # messages that may come at once after a pause
_FORGOTTEN = 10.0  # s after which a silent sender of datagrams makes room


@dataclass(frozen=True)
class Intake:
    """What is done with messages."""

    receive: Callable[[bytes | str], None]  # takes a message
    done: Callable[[], Awaitable[None]]  # waits until all that was taken has its pose
    ended: Callable[[], None]  # called when nothing more can come
    tally: Tally  # counts messages that are not taken

    def take(self, message: bytes | str, rate: Rate, now: float) -> None:
        """Take a message that comes now [s] from a sender, unless it sends too many."""
        if rate.allows(now):
            self.receive(message)
        else:
            self.tally.count(Event.TOO_FAST)


class Rate:
    """Lets one sender's messages pass, up to a number a second."""

    def __init__(self, now: float) -> None:
        # The time [s] is that of any clock that does not go back.
        self._left, self.heard = _BURST, now

    def allows(self, now: float) -> bool:
        """Tell whether a message that comes now [s] may pass."""
        self._left = min(_BURST, self._left + (now - self.heard) * _RATE)
        self.heard = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


@asynccontextmanager
async def open_source(
    address: Address, access: Access, intake: Intake
) -> AsyncIterator[Address]:
    """Hand over the messages that come to an address; yields the address in use.

    Raises InputError if the port is taken or the host is not of this machine.
    """
    if address.scheme == STANDARD:
        async with meanwhile(_read_stdin(intake)):
            yield address
    elif address.scheme == "udp":
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: Receiver(intake), local_addr=(address.host, address.port)
            )
        except OSError as error:
            raise cannot_listen(address, error) from None
        try:
            port = int(transport.get_extra_info("sockname")[1])
            yield Address("udp", address.host, port)
        finally:
            transport.close()
    else:
        handler = partial(_take_all, intake)
        async with open_server(
            handler, address, access, intake.tally, largest=LARGEST_MESSAGE
        ) as actual:
            yield actual


class Receiver(asyncio.DatagramProtocol):
    """Hands over the datagrams of a few senders, each up to a rate."""

    def __init__(self, intake: Intake) -> None:
        self._intake = intake
        self._rates: dict[Hashable, Rate] = {}

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Take a datagram."""
        now = time.perf_counter()
        rate = self.rate(addr, now)
        if rate is None:
            self._intake.tally.count(Event.REFUSED)
        else:
            self._intake.take(data, rate, now)

    def rate(self, peer: Hashable, now: float) -> Rate | None:
        """Return a sender's rate, or None where there are too many senders."""
        rates = self._rates
        if peer not in rates and len(rates) >= MOST_CONNECTIONS:
            # They never close a connection.
            silent = [p for p, rate in rates.items() if now - rate.heard >= _FORGOTTEN]
            for one in silent:
                del rates[one]
            if not silent:
                return None
        return rates.setdefault(peer, Rate(now))


async def _take_all(intake: Intake, connection: ServerConnection) -> None:
    """Take the messages of one connection."""
    from websockets.exceptions import ConnectionClosedError
    from websockets.frames import CloseCode

    rate = Rate(time.perf_counter())
    try:
        async for message in connection:
            intake.take(message, rate, time.perf_counter())
    except ConnectionClosedError as error:
        if error.sent is not None and error.sent.code == CloseCode.MESSAGE_TOO_BIG:
            intake.tally.malformed[Reason.TOO_LONG] += 1


async def _read_stdin(intake: Intake) -> None:
    """Take lines of the standard input, each after the poses of the last.

    A program that writes into a pipe can wait, so no frame is dropped.
    """
    rest, too_long = b"", False

    async def take(line: bytes) -> None:
        nonlocal too_long
        if too_long:
            intake.tally.malformed[Reason.TOO_LONG] += 1
        elif line.strip():
            intake.receive(line)
            await intake.done()
        too_long = False

    try:
        while chunk := await read_in():
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                await take(line)
            if len(rest) > LARGEST_MESSAGE:
                rest, too_long = b"", True
        await take(rest)
    finally:
        intake.ended()
