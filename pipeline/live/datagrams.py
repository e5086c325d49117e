"""Sockets that send datagrams, whether anybody listens or not."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from kinefilter.characters import InputError

from .addresses import MOST_PORT, Address


class Datagrams:
    """Sends to a host.

    Args:
        out: An open socket that does not block.
        host: The host's number.
        port: Its port.
    """

    def __init__(self, out: socket.socket, host: str, port: int) -> None:
        self._out, self._host, self._port = out, host, port

    def send(self, datagram: bytes, *, further: int = 0) -> bool:
        """Send a datagram; tell whether the system took it.

        Args:
            datagram: What to send.
            further: How many ports further than the first.
        """
        if self._port + further > MOST_PORT:
            return False
        try:
            self._out.sendto(datagram, (self._host, self._port + further))
        except OSError:  # too long, or the system's buffer is full
            return False
        return True


@contextmanager
def open_datagrams(address: Address) -> Iterator[Datagrams]:
    """Yield what sends to an address.

    Raises:
        InputError: There is no such host.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise InputError(
            f"{address}: no such host ({error.strerror or error}); check the name"
        ) from None
    family, _, _, _, place = found[0]
    with socket.socket(family, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        yield Datagrams(out, str(place[0]), address.port)
