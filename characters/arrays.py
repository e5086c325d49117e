"""The arrays that functions take and return, and arrays that nobody may change."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import fields
from types import UnionType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

Array = NDArray[np.float64]
"""Numbers in double precision; docstrings say their quantity, unit, frame and shape."""

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
"""Truths, and indices of joints, frames or points."""

Codes = NDArray[np.uint8]
"""What is said of joints by number, such as their State."""

Singles = NDArray[np.float32]
"""Numbers in single precision."""

Lengths = tuple[int | None, ...]
"""The shape of an array; None where any length will do."""

Number = TypeVar("Number", bound=np.generic)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return a view of an array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


def chunks(count: int, size: int) -> list[slice]:
    """Return slices of ``size`` frames each, to bound the memory of what follows."""
    return [slice(start, start + size) for start in range(0, count, size)]


def runs(flags: Flags, shortest: int = 1) -> list[slice]:
    """Return the spans of ``shortest`` or more frames in which flags (T,) are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    pairs = edges.reshape(-1, 2)
    long = pairs[pairs[:, 1] - pairs[:, 0] >= shortest]
    return [slice(a, b) for a, b in long.tolist()]


def shown(value: object) -> str:
    """Return the beginning of what a value looks like, for messages."""
    try:
        return repr(value)[:60].partition("\n")[0]
    except Exception:  # of somebody else's class, or a number of 5000 digits
        return f"a {type(value).__name__}"


def check_kind(value: object, kind: type | UnionType, what: str) -> None:
    """Raise an InputError if a value is of another class."""
    if not isinstance(value, kind):
        wanted = getattr(kind, "__name__", str(kind).rpartition(".")[2])
        raise InputError(f"{what} is {shown(value)}; give a {wanted}")


def check_word(value: object, known: Iterable[str], what: str) -> None:
    """Raise an InputError if a value is none of the known words."""
    words = tuple(known)
    if not isinstance(value, str) or value not in words:
        raise InputError(f"unknown {what} {shown(value)}; known: {', '.join(words)}")


def as_numbers(
    value: Any, what: str, shape: Lengths, of: str = "", *, finite: bool = False
) -> NDArray[Any]:
    """Return what somebody gave as an array; None in the shape is any length.

    Masked numbers, and None among numbers, are NaN. Raises an InputError for another
    shape, for anything but real numbers, and for NaN and inf where all are ``finite``.
    """
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(float), np.nan)
        array = np.asarray(value)
        if array.dtype.kind == "O":
            array = array.astype(float)
    except (TypeError, ValueError, OverflowError):
        array = np.array("")
    if array.dtype.kind not in ("biuf" if shape else "iuf"):
        wanted = f"numbers of shape {shape}" if shape else "a number"
        raise InputError(f"{what} is {shown(value)}, expected {wanted}{of}")
    if len(array.shape) != len(shape) or any(
        wanted not in (None, found)
        for wanted, found in zip(shape, array.shape, strict=True)
    ):
        raise InputError(f"{what} has shape {array.shape}, expected {shape}{of}")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{what} is not finite; give numbers without NaN and inf")
    return array


def as_number(value: Any, what: str) -> float:
    """Return what somebody gave as a number, or raise an InputError."""
    return float(as_numbers(value, what, ()))


def check_arrays(
    value: Any,
    what: str,
    expected: Mapping[str, Lengths],
    of: str = "",
    *,
    finite: bool = False,
    keep: Container[str] = (),
) -> None:
    """Make fields of a frozen dataclass arrays in double precision, or raise.

    The type of those to ``keep`` stays; errors are those of ``as_numbers``.
    """
    for name, shape in expected.items():
        given, where = getattr(value, name), f"{what}: {name}"
        array = as_numbers(given, where, shape, of, finite=finite)
        if name not in keep:
            array = array.astype(float, copy=False)
        object.__setattr__(value, name, array)


def freeze(value: Any) -> None:
    """Make every array field of a frozen dataclass a read-only view of itself."""
    for field in fields(value):
        array = getattr(value, field.name)
        if isinstance(array, np.ndarray):
            object.__setattr__(value, field.name, read_only(array))
