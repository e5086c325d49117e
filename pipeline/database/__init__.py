"""The motion database: where natural postures come from, and those nearest to one."""

from .posture_database import PostureDatabase, builtin_database

__all__ = ["PostureDatabase", "builtin_database"]
