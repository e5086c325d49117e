"""Streams of frames in, poses out: to engines by VMC, to browsers by WebSocket.

``tests/live_figures.py`` measures latency and memory, with one or many people, readers
that are slow and senders of nonsense.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .config import LiveConfig, OpenConfig

if TYPE_CHECKING:
    from .messages import Frame, SeenBody, format_frame, parse_frame
    from .playback import replay
    from .senders import open_sender
    from .session import Session

__all__ = [
    "Frame",
    "LiveConfig",
    "OpenConfig",
    "SeenBody",
    "Session",
    "format_frame",
    "open_sender",
    "parse_frame",
    "replay",
]

_MODULES = {
    "Frame": "messages",
    "SeenBody": "messages",
    "Session": "session",
    "format_frame": "messages",
    "open_sender": "senders",
    "parse_frame": "messages",
    "replay": "playback",
}


def __getattr__(name: str) -> Any:
    """Return what loads MuJoCo or asyncio only when it is asked for."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f".{_MODULES[name]}", __name__)
    return getattr(module, name)
