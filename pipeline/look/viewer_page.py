"""What the pages of ``view`` and ``play`` share: their panel and a queue of actions."""

import html
import queue
from collections.abc import Callable, Iterable
from typing import Any

import viser

from kinefilter.characters import InputError

Action = Callable[[Any], object]
"""What to do, given the value of the widget that was used."""


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

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        host = self._server.get_host()
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._server.get_port()}"

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
