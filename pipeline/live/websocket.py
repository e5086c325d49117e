"""A WebSocket server that only takes those who may connect."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING

from kinefilter.characters import InputError

from .access import Access
from .addresses import Address
from .limits import MOST_CONNECTIONS
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

Handler = Callable[["ServerConnection"], Awaitable[None]]

_PATIENCE = 5.0  # s for a handshake, and for the answer to a ping
_GOODBYE = 1.0  # s for the end of a connection


@asynccontextmanager
async def open_server(
    handler: Handler,
    address: Address,
    access: Access,
    tally: Tally,
    *,
    largest: int,
) -> AsyncIterator[Address]:
    """Serve WebSockets; yields the address that is listened on.

    Args:
        handler: What is done with a connection.
        address: Host and port to listen on.
        access: Who may connect.
        tally: What counts refused connections.
        largest: Bytes of a message at most; a longer one ends the connection.

    Raises:
        InputError: The port is taken or the host not ours.
    """
    from websockets.asyncio.server import serve

    scheme = "ws" if access.tls is None else "wss"
    there: set[ServerConnection] = set()

    async def handle(connection: ServerConnection) -> None:
        there.add(connection)
        try:
            await handler(connection)
        finally:
            there.discard(connection)

    try:
        server = await serve(
            handle,
            address.host,
            address.port,
            # websockets declares origins more narrowly than it takes them.
            origins=access.allowed_origins,  # type: ignore[arg-type]
            process_request=_guard(access, tally),
            ssl=access.tls,
            compression=None,  # poses are small, and time counts
            max_size=largest,
            open_timeout=_PATIENCE,
            ping_timeout=_PATIENCE,
            close_timeout=_GOODBYE,
            server_header=None,
            logger=_silent(),
        )
    except OSError as error:
        raise InputError(
            f"{address}: cannot listen there ({error.strerror or error}); "
            "choose another port or address"
        ) from None
    try:
        yield Address(scheme, address.host, _port(server))
    finally:
        await _close(server, there)


async def _close(server: Server, there: set[ServerConnection]) -> None:
    """End all connections; with whoever does not read there is no goodbye."""
    server.close()
    try:
        async with asyncio.timeout(_GOODBYE):
            await server.wait_closed()
    except TimeoutError:
        for connection in there:
            connection.transport.abort()
        await server.wait_closed()


def _guard(
    access: Access, tally: Tally
) -> Callable[[ServerConnection, Request], Response | None]:
    """Return what refuses requests of those who may not connect."""

    def guard(connection: ServerConnection, request: Request) -> Response | None:
        if not access.grants(request.path, request.headers):
            tally.count(Event.REFUSED)
            return connection.respond(HTTPStatus.UNAUTHORIZED, "a token is needed\n")
        if len(connection.server.connections) >= MOST_CONNECTIONS:
            tally.count(Event.REFUSED)
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE, "too many connections\n"
            )
        return None

    return guard


def _port(server: Server) -> int:
    """Return the port of the first socket that listens."""
    return int(next(iter(server.sockets)).getsockname()[1])


def _silent() -> logging.Logger:
    """Return a logger that says nothing: whoever knocks would fill the terminal."""
    logger = logging.getLogger("kinefilter.live")
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return logger
