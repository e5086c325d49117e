"""A simulated character that bounded forces pull through a motion."""

from .filter import Performance, PhysicsResult, PhysicsTrace, pull_through

__all__ = ["Performance", "PhysicsResult", "PhysicsTrace", "pull_through"]
