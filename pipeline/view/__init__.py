"""Motions in the browser: played, turned, and their foot contacts edited."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kinefilter.pipeline.extras import require

from .viewed import Viewed, cleaned, read_viewed

if TYPE_CHECKING:
    from .viewer import Viewer, opened_viewer

__all__ = ["Viewed", "Viewer", "cleaned", "opened_viewer", "read_viewed"]


def __getattr__(name: str) -> Any:
    """Return what loads viser only when it is asked for."""
    if name in ("Viewer", "opened_viewer"):
        require("viser", "viewing", "view")
        from . import viewer

        return getattr(viewer, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
