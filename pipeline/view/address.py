"""Addresses to listen at."""

from __future__ import annotations

import socket

from kinefilter.characters import InputError


def check_address(bind: str, port: int) -> None:
    """Raise an InputError if nothing can listen there.

    viser would try the next ports in silence, and wait forever for an address that is
    none of this machine's.
    """
    if not 0 <= port < 2**16:
        raise InputError(f"--port {port}: expected 0 (any free one) to {2**16 - 1}")
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(
            bind, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
    except OSError as error:
        if isinstance(error, socket.gaierror) or not port:
            raise InputError(
                f"--bind {bind}: no address of this machine ({error.strerror}); "
                "127.0.0.1 is for this machine alone, 0.0.0.0 for the whole network"
            ) from None
        raise taken(bind, port, error.strerror) from None


def taken(bind: str, port: int, reason: str | None = "in use") -> InputError:
    """Return the error that says why nothing can listen at a port."""
    return InputError(
        f"cannot listen at {bind}, port {port} ({reason}); give another --port, "
        "0 for any that is free"
    )
