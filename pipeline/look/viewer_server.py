"""The server of browser pages: where it listens and who may connect."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from kinefilter.characters import InputError
from kinefilter.pipeline.loopback import is_loopback

if TYPE_CHECKING:
    import viser


def check_address(bind: str, port: int) -> None:
    """Raise an InputError if a server cannot listen at an address.

    viser would try the next ports, or wait forever for another machine's address.
    """
    if not 0 <= port < 2**16:
        raise InputError(f"--port {port}: expected 0 (any free port) to {2**16 - 1}")
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
                f"--bind {bind}: not an address of this machine ({error.strerror}); "
                "use 127.0.0.1 for this machine only, 0.0.0.0 for the whole network"
            ) from None
        raise InputError(
            f"cannot listen at {bind}, port {port} ({error.strerror}); give another "
            "--port, or 0 for any free port"
        ) from None


@contextmanager
def opened_server(
    bind: str = "127.0.0.1", port: int = 0
) -> Iterator[viser.ViserServer]:
    """Yield a viser server that listens at one address, and stop it afterwards.

    Port 0 is any free port. Raises an InputError as ``check_address`` does.

    Only pages from this server may connect. With every WebSocket, a browser names the
    page that opened it (Origin, RFC 6455, section 10.2), which viser does not check. On
    loopback the page's own address must be on loopback too, or a foreign host name that
    resolves to it would be accepted.
    """
    import rich
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            """Refuse a public address: what is shown stays on this machine."""

    check_address(bind, port)
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True  # viser prints a panel of its own
    try:
        with _own_pages_only(loopback=is_loopback(bind)):
            server = Server(host=bind, port=port, verbose=False)
        try:
            if port not in (0, server.get_port()):
                check_address(bind, port)  # it was taken meanwhile
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def may_connect(origin: str | None, host: str | None, *, loopback: bool) -> bool:
    """Return True if a page from an origin may connect to the host it names."""
    if host is None or origin != f"http://{host}":
        return False
    return not loopback or is_loopback(urlsplit(f"//{host}").hostname or "")


@contextmanager
def _own_pages_only(*, loopback: bool) -> Iterator[None]:
    """Make servers that start in this context refuse WebSockets of foreign pages.

    viser starts its WebSocket server itself and sets no origins, so the function it
    calls is replaced meanwhile. Raises an InputError if viser did not call it, as then
    anyone could connect.
    """
    import viser
    import websockets.asyncio.server as library

    serve, called = library.serve, []

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            names = request.headers
            if "Upgrade" in names and not may_connect(
                names.get("Origin"), names.get("Host"), loopback=loopback
            ):
                return connection.respond(HTTPStatus.FORBIDDEN, "not from this page\n")
            return process_request(connection, request)

        called.append(True)
        return serve(*arguments, process_request=checked, **options)

    library.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = serve  # type: ignore[misc]
    if not called:
        raise InputError(
            f"viser {viser.__version__} cannot be kept from serving foreign pages; "
            'pip install "kinefilter[view]" installs a version that can'
        )
