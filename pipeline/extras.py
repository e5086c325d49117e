"""Packages that only some commands need."""

from __future__ import annotations

import importlib.util

from kinefilter.characters import InputError


def require(module: str, purpose: str, extra: str) -> None:
    """Raise an InputError if a module is not installed; do not load it.

    The message says what needs it, and which extra of kinefilter brings it.
    """
    if importlib.util.find_spec(module) is None:
        raise InputError(
            f"{purpose} needs {module}, which is not installed: "
            f'pip install "kinefilter[{extra}]"'
        )
