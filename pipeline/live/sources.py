"""Sources of messages: datagrams, WebSockets, and standard input."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Hashable
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from . import endpoints
from .background import meanwhile, read_stdin
from .endpoints import MAX_CONNECTIONS, Access, Address
from .messages import MAX_MESSAGE, Reason
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

_RATE = 240.0  # messages a second from one sender: eight times a Kinect's
_BURST = 60.0  # messages that may arrive at once after a pause
_FORGOTTEN = 10.0  # s of silence after which a sender of datagrams makes room


class Intake(NamedTuple):
    """What is done with messages."""

    receive: Callable[[bytes | str], None]  # takes a message
    done: Callable[[], Awaitable[None]]  # waits until every frame taken has its pose
    ended: Callable[[], None]  # called when no more messages can arrive
    tally: Tally  # counts rejected messages

    def take(self, message: bytes | str, rate: Rate, now: float) -> None:
        """Take a message that arrives now [s], unless its sender is too fast."""
        if rate.allows(now):
            self.receive(message)
        else:
            self.tally.events[Event.TOO_FAST] += 1


class Rate:
    """Limits the messages per second of one sender; times are of a monotonic clock."""

    def __init__(self, now: float) -> None:
        self._left, self.heard = _BURST, now

    def allows(self, now: float) -> bool:
        """Return True if a message that arrives now [s] may pass."""
        self._left = min(_BURST, self._left + (now - self.heard) * _RATE)
        self.heard = now
        allowed = self._left >= 1.0
        self._left -= float(allowed)
        return allowed


@asynccontextmanager
async def open_source(
    address: Address, access: Access, intake: Intake
) -> AsyncIterator[Address]:
    """Hand the messages that arrive at an address to the intake; yield the address.

    Raises InputError if the port is taken or the host is not this machine.
    """
    if address.scheme == endpoints.STANDARD:
        async with meanwhile(_read_stdin(intake)):
            yield address
    elif address.scheme == "udp":
        make = asyncio.get_running_loop().create_datagram_endpoint
        here = address.host, address.port
        try:
            transport, _ = await make(lambda: Receiver(intake), local_addr=here)
        except OSError as error:
            raise endpoints.cannot_listen(address, error) from None
        try:
            port = int(transport.get_extra_info("sockname")[1])
            yield Address("udp", address.host, port)
        finally:
            transport.close()
    else:
        handle = partial(take_all, intake)
        async with endpoints.open_server(
            handle, address, access, intake.tally, largest=MAX_MESSAGE
        ) as actual:
            yield actual


class Receiver(asyncio.DatagramProtocol):
    """Takes the datagrams of a few senders, each up to a rate."""

    def __init__(self, intake: Intake) -> None:
        self._intake = intake
        self._rates: dict[Hashable, Rate] = {}

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Take a datagram."""
        now = time.perf_counter()
        if (rate := self.rate(addr, now)) is None:
            self._intake.tally.events[Event.REFUSED] += 1
        else:
            self._intake.take(data, rate, now)

    def rate(self, peer: Hashable, now: float) -> Rate | None:
        """Return a sender's rate, or None if there are too many senders."""
        if peer not in self._rates:
            # Senders have no connection to close, so silent ones are forgotten.
            heard = {p: r for p, r in self._rates.items() if now - r.heard < _FORGOTTEN}
            if len(heard) >= MAX_CONNECTIONS:
                return None
            self._rates = {**heard, peer: Rate(now)}
        return self._rates[peer]


async def take_all(intake: Intake, connection: ServerConnection) -> None:
    """Hand all messages of a WebSocket to the intake, until it closes."""
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
    """Take each line once the last one has its poses; the writer of a pipe can wait."""
    rest = chunk = b"\n"
    try:
        while chunk:
            chunk = await read_stdin()
            *lines, rest = (rest + (chunk or b"\n")).split(b"\n")
            rest = rest[: MAX_MESSAGE + 1]  # enough to tell that a line is too long
            for line in lines:
                if line.strip():
                    intake.receive(line)
                    await intake.done()
    finally:
        intake.ended()
