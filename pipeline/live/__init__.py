"""Streams of frames in, poses out: to engines by VMC, to browsers by WebSocket.

``tests/live_figures.py`` measures latency and memory, with one or many people, slow
readers and senders of nonsense.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .config import AccessConfig, LiveConfig

if TYPE_CHECKING:
    from .messages import Frame, SeenBody, format_frame, parse_frame
    from .playback import open_sender, replay
    from .session import Session

__all__ = [
    "AccessConfig",
    "Frame",
    "LiveConfig",
    "SeenBody",
    "Session",
    "format_frame",
    "open_sender",
    "parse_frame",
    "replay",
]


def __getattr__(name: str) -> Any:
    """Load MuJoCo and asyncio only when a name that needs them is asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    files = {"Session": "session", "open_sender": "playback", "replay": "playback"}
    module = importlib.import_module(f".{files.get(name, 'messages')}", __name__)
    return getattr(module, name)
