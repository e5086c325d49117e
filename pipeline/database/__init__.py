"""The motion database: where natural postures come from, and those nearest to one."""

from .posture_database import PostureDatabase

__all__ = ["PostureDatabase"]
