"""Where frames come from and poses go, who may connect there, and servers for them.

A program sends the token as ``Authorization: Bearer TOKEN``. A page in a browser cannot
set that header and appends ``?token=TOKEN`` to the address.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import re
import secrets
import socket
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import read_limited
from kinefilter.pipeline.loopback import OWN_PAGES, is_loopback

from .config import AccessConfig, LiveConfig
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

STANDARD = "-"  # the scheme of the standard input and output
MOST_PORT = 2**16 - 1
_ADDRESS = re.compile(
    r"([a-z]+)://(?:\[([0-9a-f:.%]+)\]|([^]/:@?#\s[]+)):([0-9]{1,5})/?"
)
_SOURCES = ("udp", "ws", "wss", STANDARD)
_TARGETS = ("vmc", "ws", "wss", STANDARD)
_SHORTEST_TOKEN = 16  # characters; shorter ones can be guessed
_LARGEST_TOKEN_FILE = 2**12  # bytes
MOST_CONNECTIONS = 8  # senders, or readers, on a port. A guess: a room of sensors
_PATIENCE = 5.0  # s for a handshake, and for the answer to a ping
_GOODBYE = 1.0  # s for the end of a connection
_SILENT = logging.Logger("kinefilter.live")  # or any stranger could fill the terminal
_SILENT.disabled = True


@dataclass(frozen=True)
class Address:
    """One end of a connection."""

    scheme: str  # udp, ws, wss, vmc, or - for the standard input or output
    host: str = ""  # name or number of the machine
    port: int = 0  # 0 lets the system choose where something listens

    def __str__(self) -> str:
        if self.scheme == STANDARD:
            return STANDARD
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def read_address(text: str, schemes: Sequence[str]) -> Address:
    """Return the address that a text names: ``scheme://host:port`` or ``-``.

    Raises InputError if it is not such an address.
    """
    if text == STANDARD and STANDARD in schemes:
        return Address(STANDARD)
    expected = ", ".join(s if s == STANDARD else f"{s}://HOST:PORT" for s in schemes)
    found = _ADDRESS.fullmatch(text.lower())
    if found is None or found[1] not in schemes or int(found[4]) > MOST_PORT:
        raise InputError(f"{text!r} is not an address; expected one of: {expected}")
    return Address(found[1], found[2] or found[3], int(found[4]))


def listening_host(address: Address, bind: str | None) -> str:
    """Return the host that a server listens on.

    Raises InputError if others could reach it and the user did not say that they may.
    """
    if bind is None and not is_loopback(address.host):
        raise InputError(
            f"{address} would listen to other machines; write 127.0.0.1, or add "
            f"--bind {address.host} if they are meant to connect"
        )
    return address.host if bind is None else bind


@dataclass(frozen=True)
class Access:
    """What a client has to show to connect."""

    token: str | None = None  # the secret; None: not needed
    origins: tuple[str, ...] = ()  # of pages of other machines that may connect
    tls: ssl.SSLContext | None = None  # None: the connection is not encrypted

    def grants(self, path: str, headers: Headers) -> bool:
        """Tell whether a request shows the token."""
        if self.token is None:
            return True
        scheme, _, shown = headers.get("Authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            shown = parse_qs(urlsplit(path).query).get("token", [""])[0]
        # Takes as long for every wrong token as for the right one.
        return hmac.compare_digest(shown.strip().encode(), self.token.encode())

    @property
    def allowed_origins(self) -> Sequence[str | re.Pattern[str] | None]:
        """Origins as ``websockets`` takes them; None: not a page, but a program."""
        return [None, OWN_PAGES, *self.origins]


@dataclass(frozen=True)
class Endpoints:
    """Both ends of a session."""

    sources: tuple[Address, ...]  # of frames
    targets: tuple[Address, ...]  # of poses
    access: Access  # to either


def find_endpoints(config: LiveConfig, access: AccessConfig) -> Endpoints:
    """Return where frames come from and poses go.

    Where other machines can connect there is a token: that of the file, or a new one.
    Raises InputError if an address or a file is wrong, others could reach it though the
    user did not allow it, or a package is not installed.
    """
    ends = [read_address(source, _SOURCES) for source in config.sources]
    count = len(ends)
    if not count:
        raise InputError("--in is missing; give one, such as --in -")
    fixed = [end for end in ends if end.port or end.scheme == STANDARD]
    if again := [end for end in fixed if fixed.count(end) > 1]:
        raise InputError(f"--in {again[0]} twice; each sensor needs a port of its own")
    ends += [read_address(out, _TARGETS) for out in config.out]
    if len(ends) == count:
        raise InputError("--out is missing; give one, such as --out -")
    for k, end in enumerate(ends):
        if end.scheme in ("udp", "ws", "wss"):
            ends[k] = replace(end, host=listening_host(end, access.bind))
    schemes = {end.scheme for end in ends}
    if schemes & {"ws", "wss"}:
        require("websockets", "a WebSocket", "live")
    if "vmc" in schemes:
        require("pythonosc", "VMC", "live")
    token = None if access.token_file is None else read_token(access.token_file)
    if token is None and access.bind is not None and not is_loopback(access.bind):
        token = secrets.token_urlsafe()
    tls = None
    if access.certificate is not None:
        tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        try:
            # A key that needs a password would ask for it on the terminal.
            tls.load_cert_chain(access.certificate, access.key, password="")
        except OSError as error:
            reason = error.strerror or getattr(error, "reason", None) or error
            raise InputError(
                f"{access.certificate}: not a certificate with its key ({reason}); "
                "expected PEM files, the key without a password"
            ) from None
    elif "wss" in schemes:
        raise InputError("wss:// needs --certificate; give one, or write ws://")
    access_granted = Access(token, access.origin, tls)
    return Endpoints(tuple(ends[:count]), tuple(ends[count:]), access_granted)


def read_token(path: Path) -> str:
    """Return the token in a file; raises InputError if it is too short or missing."""
    token = read_limited(path, _LARGEST_TOKEN_FILE).strip()
    if len(token) < _SHORTEST_TOKEN or not token.isascii() or len(token.split()) > 1:
        raise InputError(
            f"{path}: expected a token of {_SHORTEST_TOKEN} letters and digits or "
            "more; 'openssl rand -hex 16' makes one"
        )
    return token


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

    try:
        server = await serve(
            handler,
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
        connections = server.connections
        server.close()
        try:
            async with asyncio.timeout(_GOODBYE):
                await server.wait_closed()
        except TimeoutError:  # without a goodbye to clients that do not read
            for connection in connections:
                connection.transport.abort()
            await server.wait_closed()


def cannot_listen(address: Address, error: OSError) -> InputError:
    """Return the error of a port that is taken, or a host not of this machine."""
    return InputError(
        f"{address}: cannot listen there ({error.strerror or error}); choose another "
        "port or address"
    )


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
