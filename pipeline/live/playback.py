"""Sends a recorded take as a sensor would, at its own time stamps."""

import asyncio
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, suppress
from http import HTTPStatus
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinefilter.characters import InputError, Take
from kinefilter.pipeline.extras import require

from .background import meanwhile, write_stdout
from .endpoints import STANDARD, Address, open_datagrams, read_token
from .messages import Frame, SeenBody, format_frame

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection

_MIN_SPEED = 0.001  # of the recorded speed; slower, nothing seems to happen
_FIRST_PAUSE, _LONGEST_PAUSE = 0.2, 5.0  # s between attempts, doubling every time
_PATIENCE = 5.0  # s for a connection

Send = Callable[[str], Awaitable[bool]]
"""Sends a frame; returns whether it may have arrived."""


@asynccontextmanager
async def open_sender(
    address: Address,
    *,
    token_file: Path | None = None,
    certificate: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> AsyncIterator[Send]:
    """Yield a function that sends frames; raise InputError for a wrong host or file.

    ``say`` is called with a message whenever there is nobody to send them to.
    """
    if address.scheme == STANDARD:

        async def send(line: str) -> bool:
            try:
                await write_stdout(f"{line}\n")
            except OSError:  # not EPIPE on Windows
                raise InputError("-: the reader of the output has ended") from None
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
        tls = ssl.create_default_context() if address.scheme == "wss" else None
        if tls is not None and certificate is not None:
            try:
                tls.load_verify_locations(certificate)
            except OSError as error:
                reason = f"not a certificate ({error.strerror}); expected a PEM file"
                raise InputError(f"{certificate}: {reason}") from None
        connection = _ReconnectingClient(say)
        async with meanwhile(connection.keep_open(address, token, tls)):
            await connection.tried.wait()
            if connection.refused:
                hint = "give --token-file with the receiver's token"
                raise InputError(f"{address}: the connection was refused; {hint}")
            yield connection.send


class _ReconnectingClient:
    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._open: ClientConnection | None = None
        self.tried = asyncio.Event()  # the first attempt to connect is over
        self.refused = False  # the receiver asks for another token

    async def keep_open(
        self, address: Address, token: str | None, tls: ssl.SSLContext | None
    ) -> None:
        from websockets.asyncio.client import connect
        from websockets.exceptions import InvalidStatus, WebSocketException

        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        pause = _FIRST_PAUSE
        while True:
            try:
                async with connect(
                    str(address),
                    additional_headers=headers,
                    ssl=tls,
                    open_timeout=_PATIENCE,
                    compression=None,
                    proxy=None,
                ) as connection:
                    self._open, pause = connection, _FIRST_PAUSE
                    self.tried.set()
                    await connection.wait_closed()
            except InvalidStatus as error:
                self.refused = error.response.status_code == HTTPStatus.UNAUTHORIZED
            except (OSError, WebSocketException):
                pass  # there is no server, or not yet
            self._open = None
            self.tried.set()
            if pause == _FIRST_PAUSE and not self.refused:
                self._say(f"waiting for {address}; frames until then are lost")
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, _LONGEST_PAUSE)

    async def send(self, line: str) -> bool:
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            if self._open is not None:
                await self._open.send(line)
                return True
        return False


def frames_of(takes: Sequence[Take], *, loop: bool = False) -> Iterator[Frame]:
    """Yield the frames of a recording, one per distinct time stamp.

    Its people become bodies 1, 2 and so on; those without a visible joint are left out.
    With ``loop``, it repeats forever while time continues.
    """
    time = np.unique(np.concatenate([take.time for take in takes]))
    rows = [np.searchsorted(take.time, time) for take in takes]
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    length = float(time[-1] - time[0]) + usual
    for passed in count(0.0, length) if loop else (0.0,):
        for k, stamp in enumerate(time.tolist()):
            bodies = [
                SeenBody(str(number), take.positions[row[k]], take.state[row[k]])
                for number, (take, row) in enumerate(zip(takes, rows, strict=True), 1)
                if row[k] < len(take) and take.time[row[k]] == stamp
            ]
            yield Frame(stamp + passed, tuple(body for body in bodies if body.is_seen))


async def replay(
    takes: Sequence[Take],
    send: Send,
    stop: asyncio.Event,
    *,
    speed: float = 1.0,
    loop: bool = False,
) -> int:
    """Send a recording's frames when they are due, until it ends or ``stop`` is set.

    Returns the number of frames sent. Raises InputError if the speed is below 0.001.
    """
    if not _MIN_SPEED <= speed < np.inf:
        raise InputError(
            f"--speed {speed:g}: expected {_MIN_SPEED:g} or more, such as 2"
        )
    clock = asyncio.get_running_loop()
    began, first, sent = clock.time(), min(float(take.time[0]) for take in takes), 0
    for frame in frames_of(takes, loop=loop):
        due = began + (frame.time - first) / speed
        if due > clock.time():
            with suppress(TimeoutError):
                async with asyncio.timeout_at(due):
                    await stop.wait()
        else:
            await asyncio.sleep(0.0)  # so that a replay that is late can be stopped
        if stop.is_set():
            break
        sent += await send(format_frame(frame))
    return sent
