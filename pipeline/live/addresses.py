"""Where frames come from and where poses go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.loopback import is_loopback

STANDARD = "-"
"""The scheme of the standard input and output."""
MOST_PORT = 2**16 - 1
"""The last port."""


@dataclass(frozen=True)
class Address:
    """One end of a connection."""

    scheme: str
    """udp, ws, wss, vmc, or ``-`` for the standard input or output."""
    host: str = ""
    """Name or number of the machine."""
    port: int = 0
    """Port; 0 lets the system choose where something listens."""

    def __str__(self) -> str:
        if self.scheme == STANDARD:
            return STANDARD
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def read_address(text: str, schemes: Sequence[str]) -> Address:
    """Return the address that a text names: ``scheme://host:port`` or ``-``.

    Args:
        text: What the user wrote.
        schemes: Those that are possible here.

    Raises:
        InputError: It is no such address.
    """
    if text == STANDARD and STANDARD in schemes:
        return Address(STANDARD)
    expected = ", ".join(s if s == STANDARD else f"{s}://HOST:PORT" for s in schemes)
    wrong = InputError(f"{text!r} is no address; expected one of: {expected}")
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
    """Return the address that something listens on.

    Args:
        address: What the user wrote.
        bind: ``--bind``; None: this machine alone.

    Raises:
        InputError: Others could reach it, and nobody said that they may.
    """
    if bind is not None:
        return bind
    if not is_loopback(address.host):
        raise InputError(
            f"{address} would listen to other machines; write 127.0.0.1, or add "
            f"--bind {address.host} if they are meant to connect"
        )
    return address.host
