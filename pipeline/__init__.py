"""The stages a frame passes, and the one call that runs them all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .config import CleanConfig
from .database import PostureDatabase
from .formats import Export, read_clip, read_take, read_takes, write_clip

if TYPE_CHECKING:
    from .avatar import Avatar, Pose
    from .run import CleanResult, clean

__all__ = [
    "Avatar",
    "CleanConfig",
    "CleanResult",
    "Export",
    "Pose",
    "PostureDatabase",
    "clean",
    "read_clip",
    "read_take",
    "read_takes",
    "write_clip",
]


def __getattr__(name: str) -> Any:
    """Return what loads MuJoCo and scikit-learn only when it is asked for."""
    if name in ("Avatar", "Pose"):
        from . import avatar

        return getattr(avatar, name)
    if name in ("CleanResult", "clean"):
        from . import run

        return getattr(run, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
