"""Figures, counts and names in the form that JSON, tables and terminals can hold."""

from __future__ import annotations

import math
import re
from typing import Any

# Control characters, line ends, and bytes of a name that are not UTF-8.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def finite(value: Any) -> Any:
    """Return a figure, or lists, tuples and dicts of them, ready for ``json.dumps``.

    JSON has no NaN: a number that could not be measured, or is infinite, becomes None.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(map(finite, value))
    return value


def counted(count: int, noun: str) -> str:
    """Return a number of things, such as ``1 frame`` or ``2 frames``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def printable(text: str) -> str:
    """Return a text in which what no terminal or UTF-8 file can show is as in URLs.

    A line end becomes ``%0A``, a byte E9 that is not UTF-8 ``%E9``.
    """
    return _UNPRINTABLE.sub(lambda found: f"%{ord(found[0]) & 0xFF:02X}", text)
