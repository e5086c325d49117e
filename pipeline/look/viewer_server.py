"""What the pages of ``view`` and ``play`` share: their server, panel and queue."""

import html
import queue
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import rich
import viser
import websockets.asyncio.server as library

from kinefilter.characters import InputError
from kinefilter.pipeline.loopback import is_loopback

Action = Callable[[Any], object]  # what to do, given the value of the widget used


class ServedPage:
    """A page on a server; every browser that opens it sees the same.

    Requests from browsers arrive on the server's threads and wait in a queue for
    ``run``. Only ``run`` changes anything, so no locks are needed. What raises an
    InputError is reported on the page.
    """

    _message: viser.GuiHtmlHandle

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._requests: queue.Queue[tuple[Action, Any] | None] = queue.Queue()
        plain: Any = {"show_logo": False, "show_share_button": False}
        server.gui.configure_theme(control_width="large", **plain)
        server.gui.set_panel_label("kinefilter")
        server.gui.main_panel.dock_right()
        host = server.get_host()
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        name = f"[{host}]" if ":" in host else host
        self.address = f"http://{name}:{server.get_port()}"  # to open in a browser

    def stop(self) -> None:
        """Make ``run`` return; may be called from any thread."""
        self._requests.put(None)

    def _on(
        self, register: Callable[[Any], Any], action: Action, *, whole: bool = False
    ) -> None:
        """Queue an action on an event, with the widget's value or the whole event."""

        async def enqueue(event: Any) -> None:
            # Ignore changes made by this program, and drags that have not ended.
            ended = whole or getattr(event, "phase", "end") == "end"
            if event.client is not None and ended:
                value = event if whole else getattr(event.target, "value", None)
                self._requests.put((action, value))

        register(enqueue)

    def _serve(self, wait: float | None) -> bool:
        """Wait up to ``wait`` seconds, run all requests; return False once stopped."""
        try:
            request = self._requests.get(timeout=wait)
            while request is not None:
                action, value = request
                try:
                    action(value)
                except InputError as error:
                    self._report(str(error), error=True)
                request = self._requests.get_nowait()
            return False
        except queue.Empty:
            return True

    def _report(self, text: str, *, error: bool = False) -> None:
        color = "#c92a2a" if error else "inherit"
        self._message.content = (
            f'<div id="message" style="font-size:12px;margin:0 8px;color:{color};'
            f'overflow-wrap:anywhere">{html.escape(text)}</div>'
        )


def table_html(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return an HTML table of rows (CSS style of the label, label, text)."""
    cells = "".join(
        f'<div style="{style}">{html.escape(label)}</div><div>{html.escape(text)}</div>'
        for style, label, text in rows
    )
    return (
        '<div id="status" style="display:grid;grid-template-columns:auto 1fr;'
        f'gap:1px 8px;font-size:12px;margin:2px 8px">{cells}</div>'
    )


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


class _Server(viser.ViserServer):
    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse a public address: what is shown stays on this machine."""


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
    check_address(bind, port)
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True  # viser prints a panel of its own
    try:
        with _own_pages_only(loopback=is_loopback(bind)):
            server = _Server(host=bind, port=port, verbose=False)
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
