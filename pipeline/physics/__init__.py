"""The character in MuJoCo's world: pulled along by bounded forces, among its things."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .filter import PhysicsFilter, PhysicsResult, PhysicsTrace

__all__ = ["PhysicsFilter", "PhysicsResult", "PhysicsTrace"]


def __getattr__(name: str) -> Any:
    """Return what loads MuJoCo only when it is asked for."""
    if name in __all__:
        from . import filter as simulation

        return getattr(simulation, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
