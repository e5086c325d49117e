"""The motion database: natural postures, and the search for the nearest ones."""

from .posture_database import PostureDatabase, builtin_database

__all__ = ["PostureDatabase", "builtin_database"]
