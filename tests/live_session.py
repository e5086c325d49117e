"""Live sessions of tests: on free ports of loopback, ended with the test."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from kinefilter import read_take, scenes
from kinefilter.pipeline.live.endpoints import Address
from kinefilter.pipeline.live.live_config import AccessConfig, LiveConfig
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import Frame, SeenBody, format_frame

SAMPLE = read_take(scenes.SAMPLE)
UDP, WS = "udp://127.0.0.1:0", "ws://127.0.0.1:0"
PATIENCE = 30.0  # s after which a test that waits has failed


def sample_frame(row: int, *bodies: str, time: float | None = None) -> Frame:
    """Return a frame of the sample take, seen as some bodies at once."""
    seen = tuple(
        SeenBody(body, SAMPLE.positions[row].copy(), SAMPLE.state[row].copy())
        for body in bodies or ("1",)
    )
    return Frame(row / 30.0 if time is None else time, seen)


def config(*out: str, source: str | tuple[str, ...] = UDP, **others: Any) -> LiveConfig:
    """Return a session of the sample's skeleton."""
    others = {"height": 1.8, **others}
    sources = (source,) if isinstance(source, str) else source
    return LiveConfig(sources, out or (WS,), skeleton="kinect_v1", **others)


def do(work: Coroutine[Any, Any, None]) -> None:
    """Run a test that waits, for some time at most."""

    async def bounded() -> None:
        async with asyncio.timeout(PATIENCE):
            await work

    asyncio.run(bounded())


@asynccontextmanager
async def running(
    what: LiveConfig, access: AccessConfig | None = None
) -> AsyncIterator[tuple[Session, list[Address]]]:
    """Run a session; yields it and its addresses in use."""
    session, stop = Session(what, access), asyncio.Event()
    places: asyncio.Future[list[Address]] = asyncio.get_running_loop().create_future()
    task = asyncio.ensure_future(session.run(stop, places.set_result))
    async with asyncio.timeout(PATIENCE):
        await asyncio.wait([task, places], return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        try:
            yield session, places.result()
        finally:
            stop.set()
            await asyncio.wait_for(task, PATIENCE)  # also after the time was up


class Sender:
    """Sends datagrams to a session."""

    def __init__(self, address: Address) -> None:
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._place = (address.host, address.port)

    def send(self, message: Frame | bytes) -> None:
        """Send a frame, or what is none."""
        if isinstance(message, Frame):
            message = format_frame(message).encode()
        self._out.sendto(message, self._place)


@asynccontextmanager
async def reading(address: Address, **others: Any) -> AsyncIterator[ClientConnection]:
    """Connect as a browser does; yields after the line that names the joints."""
    async with connect(str(address), **others) as stream:
        first = json.loads(await stream.recv())
        assert first["skeleton"] == "kinect_v1"
        yield stream


async def pose(stream: ClientConnection) -> dict[str, Any]:
    """Return the next pose that a reader gets."""
    found: dict[str, Any] = json.loads(await stream.recv())
    return found
