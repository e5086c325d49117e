"""The server of the page: where it listens, and who may talk to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request

from kinefilter.characters import InputError
from kinefilter.pipeline.loopback import is_loopback

from .address import check_address, taken


class _Server(viser.ViserServer):
    """viser's server, which its pages cannot ask for a public address."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: what is looked at stays on this machine."""
        del verbose
        return None


@contextmanager
def opened_server(bind: str, port: int) -> Iterator[viser.ViserServer]:
    """Yield a server of viser's page that listens at one address, and end it.

    Only pages that it served itself may connect to it: a browser says with every
    WebSocket which page opened it (Origin, RFC 6455, section 10.2), and viser does not
    look. On loopback the page's address must be one of loopback too, so that no
    foreign name that points there passes for it.

    Args:
        bind: Address to listen at.
        port: Port, 0: any that is free.

    Raises:
        InputError: Nothing can listen there.
    """
    check_address(bind, port)
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True  # viser prints a panel of its own
    try:
        with _own_pages_only(loopback=is_loopback(bind)):
            server = _Server(host=bind, port=port, verbose=False)
        try:
            if port not in (0, server.get_port()):
                raise taken(bind, port)
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def address_of(server: viser.ViserServer) -> str:
    """Return the address that a browser opens."""
    host = server.get_host()
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    name = f"[{host}]" if ":" in host else host
    return f"http://{name}:{server.get_port()}"


def may_connect(origin: str | None, host: str | None, *, loopback: bool) -> bool:
    """Tell whether a page may talk to the server that it names.

    Args:
        origin: Where the page came from, as its browser says.
        host: Whom the browser believes to talk to.
        loopback: Whether only this machine should be able to.
    """
    if origin is None or host is None:
        return False
    if loopback and not is_loopback(urlsplit(f"//{host}").hostname or ""):
        return False
    return origin == f"http://{host}"


@contextmanager
def _own_pages_only(*, loopback: bool) -> Iterator[None]:
    """Let servers that begin inside refuse WebSockets which foreign pages open.

    viser starts its server of websockets itself, without a word on origins, so the
    function that it calls is another one meanwhile.

    Raises:
        InputError: viser did not call it: nobody would look at who connects.
    """
    library = websockets.asyncio.server
    serve, asked = library.serve, []

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def checked(connection: ServerConnection, request: Request) -> Any:
            names = request.headers
            if "Upgrade" in names and not may_connect(
                names.get("Origin"), names.get("Host"), loopback=loopback
            ):
                return connection.respond(HTTPStatus.FORBIDDEN, "not from this page\n")
            return process_request(connection, request)

        asked.append(True)
        return serve(*arguments, process_request=checked, **options)

    library.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = serve  # type: ignore[misc]
    if not asked:
        raise InputError(
            f"viser {viser.__version__} cannot be kept from talking to foreign pages; "
            "install the version that kinefilter names"
        )
