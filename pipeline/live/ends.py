"""Where frames come from and poses go, checked before anything opens."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require

from .access import Access, make_access
from .addresses import STANDARD, Address, listening_host, read_address
from .config import LiveConfig, OpenConfig

_SOURCES = ("udp", "ws", "wss", STANDARD)
_SINKS = ("vmc", "ws", "wss", STANDARD)


@dataclass(frozen=True)
class Ends:
    """Both ends of a session."""

    source: Address
    """Where frames come from."""
    targets: tuple[Address, ...]
    """Where poses go."""
    access: Access
    """Who may connect to either."""


def find_ends(config: LiveConfig, opened: OpenConfig) -> Ends:
    """Return where frames come from and poses go.

    Raises:
        InputError: An address is none, others could reach it though nobody said so, a
            file is wrong, or a package is not installed.
    """
    source = _listening(read_address(config.source, _SOURCES), opened)
    targets = [_listening(read_address(out, _SINKS), opened) for out in config.out]
    if not targets:
        raise InputError("--out is missing; give one, such as --out -")
    schemes = {address.scheme for address in (source, *targets)}
    if schemes & {"ws", "wss"}:
        require("websockets", "a WebSocket", "live")
    if "vmc" in schemes:
        require("pythonosc", "VMC", "live")
    access = make_access(
        opened.bind,
        token_file=opened.token_file,
        certificate=opened.certificate,
        key=opened.key,
        origins=opened.origin,
    )
    if "wss" in schemes and access.tls is None:
        raise InputError("wss:// needs --certificate; give one, or write ws://")
    return Ends(source, tuple(targets), access)


def _listening(address: Address, opened: OpenConfig) -> Address:
    """Return the address that is listened on, or sent to."""
    if address.scheme in (STANDARD, "vmc"):
        return address
    return replace(address, host=listening_host(address, opened.bind))
