"""Where poses go, one after the other."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Protocol

from kinefilter.characters import Skeleton

from .access import Access
from .addresses import STANDARD, Address
from .broadcast import Broadcast
from .datagrams import open_datagrams
from .engine import Engine
from .poses import LivePose
from .printer import Printer
from .tally import Tally
from .websocket import open_server

_LARGEST_ASKED = 2**10  # bytes: readers have nothing to say


class Sink(Protocol):
    """Where poses go."""

    def send(self, live: LivePose) -> None:
        """Send a pose, without waiting for readers."""

    def gone(self, body: str, slot: int) -> None:
        """Say that somebody is gone."""

    async def flushed(self) -> None:
        """Wait for readers that may be waited for."""


@asynccontextmanager
async def open_sink(
    address: Address,
    access: Access,
    skeleton: Skeleton,
    tally: Tally,
    lost: Callable[[], None],
) -> AsyncIterator[tuple[Sink, Address]]:
    """Yield what poses are sent to, and its address in use.

    Args:
        address: Of the scheme ws, wss, vmc or ``-``; port 0 listens on a free one.
        access: Who may connect by WebSocket.
        skeleton: The joints of poses.
        tally: What counts lost poses.
        lost: Told when the standard output is closed.

    Raises:
        InputError: The port is taken or the host not known.
    """
    if address.scheme == STANDARD:
        printer = Printer(skeleton, tally, lost)
        try:
            yield printer, address
        finally:
            await printer.finish()
    elif address.scheme == "vmc":
        with open_datagrams(address) as out:
            yield Engine(out, tally), address
    else:
        lines = Broadcast(skeleton, tally)
        async with open_server(
            lines.handle, address, access, tally, largest=_LARGEST_ASKED
        ) as actual:
            yield lines, actual
