"""The server of the viewer's page: where it listens, and who may talk to it."""

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
    """Raise an InputError if nothing can listen at an address.

    viser would try the next ports, or wait forever for another machine's address.
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
        raise InputError(
            f"cannot listen at {bind}, port {port} ({error.strerror}); give another "
            "--port, 0 for any that is free"
        ) from None


@contextmanager
def opened_server(
    bind: str = "127.0.0.1", port: int = 0
) -> Iterator[viser.ViserServer]:
    """Yield a server of viser's page that listens at one address, and end it.

    Port 0 is any that is free. Raises as ``check_address``.

    Only pages that it served itself may connect to it: with every WebSocket a browser
    says which page opened it (Origin, RFC 6455, section 10.2), which viser does not
    check. On loopback the page's own address must be on loopback too, so that no
    foreign name that points there passes for it.
    """
    import rich
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse to get a public address: what is shown stays on this machine."""
            del verbose
            return None

    check_address(bind, port)
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True  # viser prints a panel of its own
    try:
        with _own_pages_only(loopback=is_loopback(bind)):
            server = Server(host=bind, port=port, verbose=False)
        try:
            if port not in (0, server.get_port()):
                check_address(bind, port)  # somebody was faster
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def may_connect(origin: str | None, host: str | None, *, loopback: bool) -> bool:
    """Tell whether a page from an origin may talk to the host that it names."""
    if origin is None or host is None:
        return False
    if loopback and not is_loopback(urlsplit(f"//{host}").hostname or ""):
        return False
    return origin == f"http://{host}"


@contextmanager
def _own_pages_only(*, loopback: bool) -> Iterator[None]:
    """Let servers that start inside refuse WebSockets of foreign pages.

    viser starts its websockets server itself and sets no origins, so the function that
    it calls is replaced meanwhile. If viser did not call it, nobody would check who
    connects: an InputError.
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
            f"viser {viser.__version__} cannot be kept from talking to foreign pages; "
            "install the version that kinefilter names"
        )
