"""Optional packages that only some commands need."""

import importlib.util

from kinefilter.characters import InputError


def require(module: str, purpose: str, extra: str) -> None:
    """Raise an InputError if a module, part of an extra, is not installed."""
    if importlib.util.find_spec(module) is None:
        raise InputError(
            f"{purpose} needs {module}, which is not installed: "
            f'pip install "kinefilter[{extra}]"'
        )
