"""A simulated character that bounded forces pull through a motion."""

from .filter import PhysicsResult, PhysicsTrace, Targets, pull_through

__all__ = ["PhysicsResult", "PhysicsTrace", "Targets", "pull_through"]
