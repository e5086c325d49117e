"""The character in MuJoCo's world: pulled along by bounded forces, among its things."""

from .filter import PhysicsFilter, PhysicsResult, PhysicsTrace

__all__ = ["PhysicsFilter", "PhysicsResult", "PhysicsTrace"]
