"""The stages a frame passes, and the one call that runs them all."""

from .config import CleanConfig
from .database import PostureDatabase
from .formats import read_clip, read_take, write_clip
from .run import CleanResult, clean

__all__ = [
    "CleanConfig",
    "CleanResult",
    "PostureDatabase",
    "clean",
    "read_clip",
    "read_take",
    "write_clip",
]
