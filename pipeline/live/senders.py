"""Where a replay sends frames: datagrams, a WebSocket, the standard output."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require

from .access import read_token
from .addresses import STANDARD, Address
from .datagrams import Datagrams, open_datagrams
from .printer import write_out

if TYPE_CHECKING:
    from websockets.asyncio.client import ClientConnection

_SOONEST, _LATEST = 0.2, 5.0  # s between attempts to connect, doubled every time
_PATIENCE = 5.0  # s for a connection


class Sender(Protocol):
    """Where frames go."""

    async def send(self, line: str) -> bool:
        """Send a frame; tell whether somebody may have got it."""


@asynccontextmanager
async def open_sender(
    address: Address,
    *,
    token_file: Path | None = None,
    certificate: Path | None = None,
) -> AsyncIterator[Sender]:
    """Yield what sends frames to an address.

    Args:
        address: Of the scheme udp, ws, wss or ``-``.
        token_file: Holds the token that the WebSocket asks for.
        certificate: Certificate (PEM) that is trusted beside the system's.

    Raises:
        InputError: The host is not known, or a file is wrong.
    """
    if address.scheme == STANDARD:
        yield _Printed()
    elif address.scheme == "udp":
        with open_datagrams(address) as out:
            yield _ToPort(out)
    else:
        require("websockets", "a WebSocket", "live")
        token = None if token_file is None else read_token(token_file)
        tls = _trusted(certificate) if address.scheme == "wss" else None
        connection = _Connection(address, token, tls)
        keeping = asyncio.ensure_future(connection.keep())
        try:
            await connection.tried.wait()
            if connection.refused:
                raise InputError(
                    f"{address}: refused; give --token-file with the token of the "
                    "receiver"
                )
            yield connection
        finally:
            keeping.cancel()
            await asyncio.gather(keeping, return_exceptions=True)


class _Printed:
    async def send(self, line: str) -> bool:
        """Write a line; wait where nobody reads."""
        try:
            await asyncio.to_thread(write_out, f"{line}\n".encode())
        except BrokenPipeError:
            raise InputError("-: nobody reads what is written any more") from None
        return True


class _ToPort:
    def __init__(self, out: Datagrams) -> None:
        self._out = out

    async def send(self, line: str) -> bool:
        """Send a datagram."""
        return self._out.send(line.encode())


class _Connection:
    """A connection that is made again whenever it is lost."""

    def __init__(
        self, address: Address, token: str | None, tls: ssl.SSLContext | None
    ) -> None:
        self._address, self._token, self._tls = address, token, tls
        self._open: ClientConnection | None = None
        self.tried = asyncio.Event()
        """Set when the first attempt to connect is over."""
        self.refused = False
        """Whether the other side asks for another token."""

    async def keep(self) -> None:
        """Connect, and connect again, for ever."""
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
                pass  # nobody is there, or not yet
            self._open = None
            self.tried.set()
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, _LATEST)

    async def send(self, line: str) -> bool:
        """Send a message if there is a connection."""
        from websockets.exceptions import ConnectionClosed

        if self._open is None:
            return False
        try:
            await self._open.send(line)
        except ConnectionClosed:
            return False
        return True


def _trusted(certificate: Path | None) -> ssl.SSLContext:
    """Return what tells whom to trust."""
    try:
        context = ssl.create_default_context()
        if certificate is not None:
            context.load_verify_locations(certificate)
    except (ssl.SSLError, OSError) as error:
        raise InputError(
            f"{certificate}: no certificate ({error.strerror}); expected a PEM file"
        ) from None
    return context
