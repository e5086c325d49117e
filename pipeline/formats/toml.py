"""TOML files that users write."""

from __future__ import annotations

import os
import tomllib
from typing import Any

from kinefilter.characters import InputError

from .files import read_limited

LARGEST_TOML = 2**16
"""Bytes of a file that somebody wrote by hand."""


def read_toml(path: str | os.PathLike[str], expected: str) -> dict[str, Any]:
    """Return the table in a file.

    Args:
        path: The file.
        expected: What to write instead of what is wrong, for messages.

    Raises:
        InputError: The file is missing, too large, or no TOML.
    """
    return parse_toml(read_limited(path, LARGEST_TOML), os.fspath(path), expected)


def parse_toml(text: str, name: str, expected: str) -> dict[str, Any]:
    """Return the table that a text describes.

    Args:
        text: TOML.
        name: Where it is, for messages.
        expected: What to write instead of what is wrong, for messages.

    Raises:
        InputError: It is no TOML.
    """
    try:
        return tomllib.loads(text)
    # Not its own error alone: numbers of thousands of digits, brackets in thousands.
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: no TOML ({error}); {expected}") from None
