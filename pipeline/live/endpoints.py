"""Where frames come from and poses go, and who may connect there.

A program sends the token as ``Authorization: Bearer TOKEN``. A page in a browser cannot
set that header and appends ``?token=TOKEN`` to the address.
"""

from __future__ import annotations

import hmac
import re
import secrets
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import read_limited
from kinefilter.pipeline.loopback import OWN_PAGES, is_loopback

from .config import AccessConfig, LiveConfig

if TYPE_CHECKING:
    from websockets.datastructures import Headers

STANDARD = "-"  # the scheme of the standard input and output
MOST_PORT = 2**16 - 1
_SOURCES = ("udp", "ws", "wss", STANDARD)
_TARGETS = ("vmc", "ws", "wss", STANDARD)
_SHORTEST_TOKEN = 16  # characters; shorter ones can be guessed
_LARGEST_TOKEN_FILE = 2**12  # bytes


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
    wrong = InputError(f"{text!r} is not an address; expected one of: {expected}")
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise wrong from None
    rest = (parts.query, parts.fragment, parts.username, parts.password)
    if parts.scheme not in schemes or not host or port is None or any(rest):
        raise wrong
    if parts.path not in ("", "/") or not 0 <= port <= MOST_PORT:
        raise wrong
    return Address(parts.scheme, host, port)


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

    source: Address  # of frames
    targets: tuple[Address, ...]  # of poses
    access: Access  # to either


def find_endpoints(config: LiveConfig, access: AccessConfig) -> Endpoints:
    """Return where frames come from and poses go.

    Where other machines can connect there is a token: that of the file, or a new one.
    Raises InputError if an address or a file is wrong, others could reach it though the
    user did not allow it, or a package is not installed.
    """
    addresses = [
        read_address(config.source, _SOURCES),
        *(read_address(out, _TARGETS) for out in config.out),
    ]
    source, *targets = (
        replace(address, host=listening_host(address, access.bind))
        if address.scheme in ("udp", "ws", "wss")
        else address
        for address in addresses
    )
    if not targets:
        raise InputError("--out is missing; give one, such as --out -")
    schemes = {address.scheme for address in (source, *targets)}
    if schemes & {"ws", "wss"}:
        require("websockets", "a WebSocket", "live")
    if "vmc" in schemes:
        require("pythonosc", "VMC", "live")
    token = None if access.token_file is None else read_token(access.token_file)
    if token is None and access.bind is not None and not is_loopback(access.bind):
        token = secrets.token_urlsafe()
    tls = None
    if access.certificate is not None:
        tls = _server_context(access.certificate, access.key)
    if "wss" in schemes and tls is None:
        raise InputError("wss:// needs --certificate; give one, or write ws://")
    return Endpoints(source, tuple(targets), Access(token, access.origin, tls))


def read_token(path: Path) -> str:
    """Return the token in a file; raises InputError if it is too short or missing."""
    token = read_limited(path, _LARGEST_TOKEN_FILE).strip()
    if len(token) < _SHORTEST_TOKEN or not token.isascii() or len(token.split()) > 1:
        raise InputError(
            f"{path}: expected a token of {_SHORTEST_TOKEN} letters and digits or "
            "more; 'openssl rand -hex 16' makes one"
        )
    return token


def _server_context(certificate: Path, key: Path | None) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        # A key that needs a password would ask for it on the terminal.
        context.load_cert_chain(certificate, key, password="")
    except (ssl.SSLError, OSError) as error:
        reason = error.strerror or error.reason if hasattr(error, "reason") else error
        raise InputError(
            f"{certificate}: not a certificate with its key ({reason}); expected PEM "
            "files, the key without a password"
        ) from None
    return context
