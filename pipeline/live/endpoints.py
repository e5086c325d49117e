"""Addresses of frames and poses, who may connect to them, and the servers there.

A program sends the token as ``Authorization: Bearer TOKEN``. A page in a browser cannot
set that header, and appends ``?token=TOKEN`` to the address instead.
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
from contextlib import asynccontextmanager, contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import parse_qs, urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import read_limited
from kinefilter.pipeline.loopback import OWN_PAGES, is_loopback

from .live_config import AccessConfig, LiveConfig
from .tally import Event, Tally

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response

STANDARD = "-"  # the scheme of standard input and output
_MAX_PORT = 2**16 - 1
_ADDRESS = re.compile(
    r"([a-z]+)://(?:\[([0-9a-f:.%]+)\]|([^]/:@?#\s[]+)):([0-9]{1,5})/?"
)
_SOURCES = ("udp", "ws", "wss", STANDARD)
ENGINES = ("vmc", "vrchat")  # take OSC messages
_TARGETS = (*ENGINES, "ws", "wss", STANDARD)
_FOR_WEBSOCKETS = ("origin", "token_file", "certificate", "key")
_MIN_TOKEN = 16  # characters; shorter tokens can be guessed
_MAX_TOKEN_FILE = 2**12  # bytes
MAX_CONNECTIONS = 8  # senders or readers per port: a room of sensors. A guess
_PATIENCE = 5.0  # s for a handshake, and for the answer to a ping
_GOODBYE = 1.0  # s for closing a connection
_SILENT = logging.Logger("kinefilter.live")  # or strangers could flood the terminal
_SILENT.disabled = True


class Address(NamedTuple):
    """One end of a connection."""

    scheme: str  # udp, ws, wss, vmc, vrchat, or - for standard input or output
    host: str = ""  # name or IP address of the machine
    port: int = 0  # 0 lets the system choose a port to listen on

    def __str__(self) -> str:
        if self.scheme == STANDARD:
            return STANDARD
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse_address(text: str, schemes: Sequence[str]) -> Address:
    """Parse ``scheme://host:port`` or ``-``; raise InputError if it is invalid."""
    if text == STANDARD and STANDARD in schemes:
        return Address(STANDARD)
    expected = ", ".join(s if s == STANDARD else f"{s}://HOST:PORT" for s in schemes)
    found = _ADDRESS.fullmatch(text.lower())
    if found is None or found[1] not in schemes or int(found[4]) > _MAX_PORT:
        raise InputError(f"{text!r} is not an address; expected one of: {expected}")
    return Address(found[1], found[2] or found[3], int(found[4]))


def listening_host(address: Address, bind: str | None) -> str:
    """Return the host to listen on; raise InputError if others need ``--bind``."""
    if bind is None and not is_loopback(address.host):
        raise InputError(
            f"{address} would accept connections from other machines; write 127.0.0.1, "
            f"or add --bind {address.host} if they are meant to connect"
        )
    return address.host if bind is None else bind


class Access(NamedTuple):
    """What a client must present to connect."""

    token: str | None = None  # the secret; None: no token is needed
    origins: tuple[str, ...] = ()  # of other machines' web pages that may connect
    tls: ssl.SSLContext | None = None  # None: connections are not encrypted

    def admits(self, headers: Headers) -> bool:
        """Return True if a request is from a program, or a page that may connect."""
        return all(
            OWN_PAGES.fullmatch(origin) or origin in self.origins
            for origin in headers.get_all("Origin")
        )

    def grants(self, path: str, headers: Headers) -> bool:
        """Return True if a request presents the token, or none is needed."""
        if self.token is None:
            return True
        scheme, _, shown = headers.get("Authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            shown = parse_qs(urlsplit(path).query).get("token", [""])[0]
        # In constant time, so that it does not reveal how much of a token is right.
        return hmac.compare_digest(shown.strip().encode(), self.token.encode())


class Endpoints(NamedTuple):
    """Both ends of a session."""

    sources: tuple[Address, ...]  # of frames
    targets: tuple[Address, ...]  # of poses
    access: Access  # to either


def find_endpoints(
    config: LiveConfig, access: AccessConfig, *, shown: bool = False
) -> Endpoints:
    """Return where frames come from and poses go, nowhere if they are only ``shown``.

    If other machines can connect there is a token, from the file or a new one. Raises
    InputError if an address or a file is wrong, other machines could connect without
    ``--bind``, or a package is not installed.
    """
    sources = [parse_address(source, _SOURCES) for source in config.sources]
    if not sources:
        raise InputError("--in is missing; give one, such as --in -")
    fixed = [end for end in sources if end.port or end.scheme == STANDARD]
    if again := [end for end in fixed if fixed.count(end) > 1]:
        raise InputError(
            f"--in {again[0]} is given twice; each sensor needs a port of its own"
        )
    ends = sources + [parse_address(out, _TARGETS) for out in config.out]
    if len(ends) == len(sources) and not shown:
        raise InputError("--out is missing; give one, such as --out -")
    for k, end in enumerate(ends):
        if end.scheme in ("udp", "ws", "wss"):
            if shown and not is_loopback(end.host):
                raise InputError(
                    f"{end}: play hears only this machine; write 127.0.0.1, or use live"
                )
            ends[k] = end._replace(host=listening_host(end, access.bind))
    schemes = {end.scheme for end in ends}
    if schemes & {"ws", "wss"}:
        require("websockets", "a WebSocket", "live")
    elif given := [name for name in _FOR_WEBSOCKETS if getattr(access, name)]:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} needs a WebSocket; add --out ws://HOST:PORT")
    if schemes & set(ENGINES):
        require("pythonosc", "OSC", "live")
    token = None if access.token_file is None else read_token(access.token_file)
    if token is None and access.bind is not None and not is_loopback(access.bind):
        token = secrets.token_urlsafe()
    tls = None
    if access.certificate is not None:
        tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        try:
            # Without a password, an encrypted key would prompt for it on the terminal.
            tls.load_cert_chain(access.certificate, access.key, password="")
        except OSError as error:
            reason = error.strerror or getattr(error, "reason", None) or error
            raise InputError(
                f"{access.certificate}: not a certificate with its key ({reason}); "
                "expected PEM files, and a key without a password"
            ) from None
    elif "wss" in schemes:
        raise InputError("wss:// needs --certificate; give one, or write ws://")
    granted, count = Access(token, access.origin, tls), len(sources)
    return Endpoints(tuple(ends[:count]), tuple(ends[count:]), granted)


def read_token(path: Path) -> str:
    """Return the token in a file; raise InputError if it is missing or too short."""
    token = read_limited(path, _MAX_TOKEN_FILE).strip()
    if len(token) < _MIN_TOKEN or not token.isascii() or len(token.split()) > 1:
        raise InputError(
            f"{path}: expected a token of at least {_MIN_TOKEN} letters and digits; "
            "'openssl rand -hex 16' makes one"
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
    """Serve WebSockets, with messages of ``largest`` bytes; yield the address in use.

    Raises InputError if the port is taken or the host is not this machine.
    """
    from websockets.asyncio.server import serve

    def guard(connection: ServerConnection, request: Request) -> Response | None:
        if not access.admits(request.headers):
            status, reason = HTTPStatus.FORBIDDEN, "add --origin for such a page\n"
        elif not access.grants(request.path, request.headers):
            status, reason = HTTPStatus.UNAUTHORIZED, "a token is needed\n"
        elif len(connection.server.connections) >= MAX_CONNECTIONS:
            status, reason = HTTPStatus.SERVICE_UNAVAILABLE, "too many connections\n"
        else:
            return None
        tally.events[Event.REFUSED] += 1
        return connection.respond(status, reason)

    try:
        server = await serve(
            handler,
            address.host,
            address.port,
            process_request=guard,
            ssl=access.tls,
            compression=None,  # poses are small, and latency matters
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
        except TimeoutError:  # some client does not read
            for connection in connections:
                connection.transport.abort()
            await server.wait_closed()


def cannot_listen(address: Address, error: OSError) -> InputError:
    """Return the error for a port that is taken, or a host that is not this machine."""
    reason = error.strerror or error
    return InputError(f"{address}: cannot listen there ({reason}); use another address")


Datagrams = Callable[[bytes, int], bool]
"""Sends a datagram to the address's port plus an offset; returns whether it left."""


@contextmanager
def open_datagrams(address: Address) -> Iterator[Datagrams]:
    """Yield a sender of datagrams; raise InputError if there is no such host."""
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(
            f"{address}: no such host ({error.strerror or error}); check the name"
        ) from None
    family, _, _, _, place = found[0]

    def send(datagram: bytes, offset: int) -> bool:
        with suppress(OSError):  # too long, or the system's buffer is full
            if address.port + offset <= _MAX_PORT:
                out.sendto(datagram, (str(place[0]), address.port + offset))
                return True
        return False

    with socket.socket(family, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        yield send
