"""Clips into pictures: what is shown, from where, and into which file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .look import Look

if TYPE_CHECKING:
    from .clips import Rendering, render_clips

__all__ = ["Look", "Rendering", "render_clips"]


def __getattr__(name: str) -> Any:
    """Return what loads MuJoCo only when it is asked for."""
    if name in ("Rendering", "render_clips"):
        from . import clips

        return getattr(clips, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
