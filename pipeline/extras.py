"""Packages that only some commands need."""

from __future__ import annotations

import importlib.util

from kinefilter.characters import InputError


def require(module: str, purpose: str, extra: str) -> None:
    """Raise an InputError if a package is not installed; do not load it.

    Args:
        module: What is imported, such as ``websockets``.
        purpose: What needs it, for the message.
        extra: The extra of kinefilter that brings it.
    """
    if importlib.util.find_spec(module) is None:
        raise InputError(
            f"{purpose} needs {module}, which is not installed: "
            f'pip install "kinefilter[{extra}]"'
        )
