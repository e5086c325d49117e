"""What only live streams need, and who does not have it is told."""

from __future__ import annotations

import importlib.util

from kinefilter.characters import InputError

__all__ = ["require"]


def require(module: str, purpose: str) -> None:
    """Raise an InputError if a package of the extra ``live`` is not installed.

    Args:
        module: What is imported, such as ``websockets``.
        purpose: What needs it, for the message.
    """
    if importlib.util.find_spec(module) is None:
        raise InputError(
            f"{purpose} needs {module}, which is not installed: "
            'pip install "kinefilter[live]"'
        )
