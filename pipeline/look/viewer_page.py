"""A page of viser's: what its panel and all browsers that open it have in common."""

from __future__ import annotations

import html
import queue
from collections.abc import Callable, Iterable
from typing import Any

import viser

Action = Callable[[Any], object]
"""What is to be done, given the value of the widget that asked for it."""


class ServedPage:
    """A page on a server; every browser that opens it sees the same.

    What browsers ask for comes from threads of the server. It waits in a queue for
    ``run``, which alone changes anything, so that no locks are needed.
    """

    _said: viser.GuiHtmlHandle

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._asked: queue.Queue[tuple[Action, Any] | None] = queue.Queue()
        plain: Any = {"show_logo": False, "show_share_button": False}
        server.gui.configure_theme(control_width="large", **plain)
        server.gui.set_panel_label("kinefilter")
        server.gui.main_panel.dock_right()

    @property
    def address(self) -> str:
        """What a browser opens."""
        host = self._server.get_host()
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self._server.get_port()}"

    def stop(self) -> None:
        """Let ``run`` return; from any thread."""
        self._asked.put(None)

    def _on(
        self, register: Callable[[Any], Any], action: Action, *, whole: bool = False
    ) -> None:
        """Let an action wait for its turn, with a widget's value or the whole event."""

        async def ask(event: Any) -> None:
            # Not where this program changed a widget, or while something is dragged.
            ended = whole or getattr(event, "phase", "end") == "end"
            if event.client is not None and ended:
                value = event if whole else getattr(event.target, "value", None)
                self._asked.put((action, value))

        register(ask)

    def _say(self, words: str, *, wrong: bool = False) -> None:
        color = "#c92a2a" if wrong else "inherit"
        self._said.content = (
            f'<div id="said" style="font-size:12px;margin:0 8px;color:{color};'
            f'overflow-wrap:anywhere">{html.escape(words)}</div>'
        )


def table_html(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return rows of a style, a name and a text as HTML."""
    cells = "".join(
        f'<div style="{style}">{html.escape(name)}</div><div>{html.escape(text)}</div>'
        for style, name, text in rows
    )
    return (
        '<div id="status" style="display:grid;grid-template-columns:auto 1fr;'
        f'gap:1px 8px;font-size:12px;margin:2px 8px">{cells}</div>'
    )
