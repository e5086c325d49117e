"""Numbers, counts and names in a form that JSON, tables and terminals can hold."""

import math
import re
from collections.abc import Sequence
from typing import Any

# Control characters, line ends, and bytes of a name that are not UTF-8.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")

_MOST_TOLD = 5  # times that are listed one by one; more are counted


def finite(value: Any) -> Any:
    """Return a nested value ready for JSON: NaN and infinite numbers become None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(map(finite, value))
    return value


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 frame`` or ``2 frames``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def times_told(spans: Sequence[tuple[float, float]]) -> str:
    """Return times [s] in words, such as ``at 1.2, 3.4 to 5.6 s``; many are counted."""
    ends = [(f"{begin:.1f}", f"{end:.1f}") for begin, end in spans[:_MOST_TOLD]]
    told = ", ".join(f"at {a}" if a == b else f"{a} to {b}" for a, b in ends)
    left = len(spans) - len(ends)
    return f"{told} s" + (f" and {counted(left, 'more time')}" if left else "")


def printable(text: str) -> str:
    """Return text with its unprintable characters percent-encoded, as in URLs.

    A line end becomes ``%0A``, and a byte E9 that is not UTF-8 becomes ``%E9``.
    """
    return _UNPRINTABLE.sub(lambda match: f"%{ord(match[0]) & 0xFF:02X}", text)
