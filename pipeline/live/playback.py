"""A recorded take sent as a sensor would send it, at its own time stamps.

It goes out as datagrams, through a WebSocket, or to the standard output.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import InputError, Take
from kinefilter.pipeline.extras import require

from .background import meanwhile, write_out
from .endpoints import STANDARD, Address, open_datagrams, read_token
from .messages import Frame, SeenBody, format_frame

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection

_SLOWEST = 0.001  # times as fast as recorded: slower, nothing seems to happen
_SOONEST, _LATEST = 0.2, 5.0  # s between attempts to connect, doubled every time
_PATIENCE = 5.0  # s for a connection


Send = Callable[[str], Awaitable[bool]]
"""Sends a frame; tells whether it may have arrived."""


@asynccontextmanager
async def open_sender(
    address: Address, *, token_file: Path | None = None, certificate: Path | None = None
) -> AsyncIterator[Send]:
    """Yield what sends frames to an address.

    Raises InputError if the host is not known, or a file is wrong.
    """
    if address.scheme == STANDARD:

        async def send(line: str) -> bool:
            try:
                await write_out(f"{line}\n")
            except OSError:  # Windows has another one than EPIPE
                ended = "-: the program that read the output has ended"
                raise InputError(ended) from None
            return True

        yield send
    elif address.scheme == "udp":
        with open_datagrams(address) as out:

            async def send(line: str) -> bool:
                return out(line.encode(), 0)

            yield send
    else:
        require("websockets", "a WebSocket", "live")
        token = None if token_file is None else read_token(token_file)
        tls = None
        if address.scheme == "wss":
            tls = ssl.create_default_context()
            try:
                if certificate is not None:
                    tls.load_verify_locations(certificate)
            except OSError as error:
                reason = f"not a certificate ({error.strerror}); expected a PEM file"
                raise InputError(f"{certificate}: {reason}") from None
        connection = _Connection(address, token, tls)
        async with meanwhile(connection.keep()):
            await connection.tried.wait()
            if connection.refused:
                hint = "give --token-file with the receiver's token"
                raise InputError(f"{address}: refused; {hint}")
            yield connection.send


class _Connection:
    """A connection that is made again whenever it is lost."""

    def __init__(
        self, address: Address, token: str | None, tls: ssl.SSLContext | None
    ) -> None:
        self._address, self._token, self._tls = address, token, tls
        self._open: ClientConnection | None = None
        self.tried = asyncio.Event()  # the first attempt to connect is over
        self.refused = False  # the other side asks for another token

    async def keep(self) -> None:
        from websockets.asyncio.client import connect
        from websockets.exceptions import InvalidStatus, WebSocketException

        headers = {}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        pause = _SOONEST
        while True:
            try:
                async with connect(
                    str(self._address),
                    additional_headers=headers,
                    ssl=self._tls,
                    open_timeout=_PATIENCE,
                    compression=None,
                    proxy=None,
                ) as connection:
                    self._open, pause = connection, _SOONEST
                    self.tried.set()
                    await connection.wait_closed()
            except InvalidStatus as error:
                self.refused = error.response.status_code == HTTPStatus.UNAUTHORIZED
            except (OSError, WebSocketException):
                pass  # no server is there, or not yet
            self._open = None
            self.tried.set()
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, _LATEST)

    async def send(self, line: str) -> bool:
        from websockets.exceptions import ConnectionClosed

        if self._open is None:
            return False
        try:
            await self._open.send(line)
        except ConnectionClosed:
            return False
        return True


def frames_of(takes: Sequence[Take], *, loop: bool = False) -> Iterator[Frame]:
    """Yield the frames of a recording, those of one stamp together.

    Its people become bodies 1, 2 and so on; those of whom no joint is seen are left
    out. With ``loop`` it begins again at the end, and time goes on.
    """
    time = np.unique(np.concatenate([take.time for take in takes]))
    rows = [np.searchsorted(take.time, time) for take in takes]
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    passed, length = 0.0, float(time[-1] - time[0]) + usual
    while True:
        for k, stamp in enumerate(time.tolist()):
            bodies = [
                SeenBody(str(number), take.positions[row[k]], take.state[row[k]])
                for number, (take, row) in enumerate(zip(takes, rows, strict=True), 1)
                if row[k] < len(take) and take.time[row[k]] == stamp
            ]
            seen = tuple(body for body in bodies if body.is_seen)
            yield Frame(stamp + passed, seen)
        if not loop:
            return
        passed += length


async def replay(
    takes: Sequence[Take],
    send: Send,
    stop: asyncio.Event,
    *,
    speed: float = 1.0,
    loop: bool = False,
) -> int:
    """Send a recording's frames when they are due, until it ends or is stopped.

    Returns how many were sent. Raises InputError if the speed is not over 0.
    """
    if not _SLOWEST <= speed < np.inf:
        raise InputError(f"--speed {speed:g}: expected {_SLOWEST:g} or more, such as 2")
    clock = asyncio.get_running_loop()
    began, first, sent = clock.time(), None, 0
    for frame in frames_of(takes, loop=loop):
        first = frame.time if first is None else first
        due = began + (frame.time - first) / speed
        if due > clock.time():
            with suppress(TimeoutError):
                async with asyncio.timeout_at(due):
                    await stop.wait()
        else:
            await asyncio.sleep(0.0)  # or nobody who is late could be stopped
        if stop.is_set():
            break
        sent += await send(format_frame(frame))
    return sent
