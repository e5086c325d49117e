"""Servers of WebSockets, which take only who may connect, and sockets of datagrams."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING

from kinefilter.characters import InputError

from .endpoints import MOST_PORT, Access, Address
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

MOST_CONNECTIONS = 8  # senders, or readers, on a port. A guess: a room of sensors
_PATIENCE = 5.0  # s for a handshake, and for the answer to a ping
_GOODBYE = 1.0  # s for the end of a connection
_SILENT = logging.Logger("kinefilter.live")  # or any stranger could fill the terminal
_SILENT.disabled = True


@asynccontextmanager
async def open_server(
    handler: Callable[[ServerConnection], Awaitable[None]],
    address: Address,
    access: Access,
    tally: Tally,
    *,
    largest: int,
) -> AsyncIterator[Address]:
    """Serve WebSockets; yields the address in use.

    Raises InputError if the port is taken or the host is not of this machine.
    """
    from websockets.asyncio.server import serve

    connections: set[ServerConnection] = set()

    def guard(connection: ServerConnection, request: Request) -> Response | None:
        """Refuse clients that may not connect."""
        if not access.grants(request.path, request.headers):
            status, reason = HTTPStatus.UNAUTHORIZED, "a token is needed\n"
        elif len(connection.server.connections) >= MOST_CONNECTIONS:
            status, reason = HTTPStatus.SERVICE_UNAVAILABLE, "too many connections\n"
        else:
            return None
        tally.count(Event.REFUSED)
        return connection.respond(status, reason)

    async def handle(connection: ServerConnection) -> None:
        connections.add(connection)
        try:
            await handler(connection)
        finally:
            connections.discard(connection)

    try:
        server = await serve(
            handle,
            address.host,
            address.port,
            # websockets declares origins more narrowly than it takes them.
            origins=access.allowed_origins,  # type: ignore[arg-type]
            process_request=guard,
            ssl=access.tls,
            compression=None,  # poses are small, and time counts
            max_size=largest,
            open_timeout=_PATIENCE,
            ping_timeout=_PATIENCE,
            close_timeout=_GOODBYE,
            server_header=None,
            logger=_SILENT,
        )
    except OSError as error:
        raise cannot_listen(address, error) from None
    try:
        port = int(next(iter(server.sockets)).getsockname()[1])
        yield Address("ws" if access.tls is None else "wss", address.host, port)
    finally:
        await _close(server, connections)


def cannot_listen(address: Address, error: OSError) -> InputError:
    """Return the error of a port that is taken, or a host not of this machine."""
    return InputError(
        f"{address}: cannot listen there ({error.strerror or error}); choose another "
        "port or address"
    )


async def _close(server: Server, connections: set[ServerConnection]) -> None:
    """End all connections, without a goodbye to clients that do not read."""
    server.close()
    try:
        async with asyncio.timeout(_GOODBYE):
            await server.wait_closed()
    except TimeoutError:
        for connection in connections:
            connection.transport.abort()
        await server.wait_closed()


Datagrams = Callable[[bytes, int], bool]
"""Sends a datagram to a port so many further than the first, whether a program listens
there or not; tells whether the system took it."""


@contextmanager
def open_datagrams(address: Address) -> Iterator[Datagrams]:
    """Yield what sends to an address; raises InputError if there is no such host."""
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(
            f"{address}: no such host ({error.strerror or error}); check the name"
        ) from None
    family, _, _, _, place = found[0]

    def send(datagram: bytes, offset: int) -> bool:
        if address.port + offset > MOST_PORT:
            return False
        try:
            out.sendto(datagram, (str(place[0]), address.port + offset))
        except OSError:  # too long, or the system's buffer is full
            return False
        return True

    with socket.socket(family, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        yield send
