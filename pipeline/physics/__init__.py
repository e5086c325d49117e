"""A simulated character that bounded forces pull through a motion."""

from .filter import PhysicsFilter, PhysicsResult, PhysicsTrace

__all__ = ["PhysicsFilter", "PhysicsResult", "PhysicsTrace"]
