"""What is drawn of takes and clips: videos, the viewer in the browser, report pages.

``drawing`` describes what is drawn; ``video``, ``viewer`` and ``page`` each turn that
description into their medium.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kinefilter.pipeline.extras import require

if TYPE_CHECKING:
    from .comparison import compare, read_comparison, read_drawing
    from .drawing import Drawing, cleaned
    from .metric_limits import parse_limit, read_limits
    from .options import Look
    from .page import check_report, write_report
    from .video import render_clips
    from .viewer import Viewer, opened_viewer

__all__ = [
    "Drawing",
    "Look",
    "Viewer",
    "check_report",
    "cleaned",
    "compare",
    "opened_viewer",
    "parse_limit",
    "read_comparison",
    "read_drawing",
    "read_limits",
    "render_clips",
    "write_report",
]

_MODULES = {
    "comparison": ("compare", "read_comparison", "read_drawing"),
    "drawing": ("Drawing", "cleaned"),
    "metric_limits": ("parse_limit", "read_limits"),
    "options": ("Look",),
    "page": ("check_report", "write_report"),
    "video": ("render_clips",),
    "viewer": ("Viewer", "opened_viewer"),
}


def __getattr__(name: str) -> Any:
    """Import what is asked for, and only that."""
    for module, names in _MODULES.items():
        if name in names:
            if module == "viewer":
                require("viser", "viewing", "view")
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
