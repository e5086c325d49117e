"""What the page needs beside kinefilter itself."""

from __future__ import annotations

from importlib.util import find_spec

from kinefilter.characters import InputError

__all__ = ["check_viser"]


def check_viser() -> None:
    """Raise an InputError if viser is not installed; do not load it."""
    if find_spec("viser") is None:
        raise InputError('viewing needs viser: pip install "kinefilter[view]"')
