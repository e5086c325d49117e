"""Array types, checks of arrays that users pass, and read-only arrays."""

from collections.abc import Container, Iterable, Mapping
from dataclasses import fields
from types import UnionType
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

Array = NDArray[np.float64]
"""Double-precision numbers; docstrings give their quantity, unit, frame and shape."""
Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Codes = NDArray[np.uint8]  # integer codes of an enumeration, such as State
Lengths = tuple[int | None, ...]  # shape of an array; None where any length is allowed
Number = TypeVar("Number", bound=np.generic)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def chunks(count: int, size: int = 1000) -> list[slice]:
    """Return slices of ``size`` frames that cover ``count`` frames, to bound memory."""
    return [slice(start, start + size) for start in range(0, count, size)]


def solved(systems: Array, right: Array) -> Array:
    """Return the solutions (..., N, C) of positive definite systems (..., N, N)."""
    if systems.size > systems.shape[-1] ** 2:
        return np.asarray(np.linalg.solve(systems, right))
    from scipy.linalg.lapack import dposv  # slow to load, but numpy's checks are slower

    one = systems.reshape(systems.shape[-2:]), right.reshape(right.shape[-2:])
    return np.asarray(dposv(*one)[1].reshape(right.shape))


def runs(flags: Flags, shortest: int = 1) -> list[slice]:
    """Return the runs of at least ``shortest`` frames in which flags (T,) are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    pairs = edges.reshape(-1, 2).tolist()
    return [slice(begin, end) for begin, end in pairs if end - begin >= shortest]


def shown(value: object) -> str:
    """Return the beginning of the repr of a value, for error messages."""
    try:
        text = repr(value)
        line = text[:60].partition("\n")[0]
        return line if line == text else f"{line[:57]}..."
    except Exception:  # a class with a broken repr, or an integer of 5000 digits
        return f"a {type(value).__name__}"


def check_kind(value: object, kind: type | UnionType, what: str) -> None:
    """Raise an InputError if a value is not an instance of a class."""
    if not isinstance(value, kind):
        kinds = [one.__name__ for one in get_args(kind) or (kind,)]
        wanted = " or ".join(name for name in kinds if name != "NoneType")
        article = "an" if wanted[0] in "AEIOU" else "a"
        raise InputError(f"{what} must be {article} {wanted}, got {shown(value)}")


def check_choice(value: object, known: Iterable[str], what: str) -> None:
    """Raise an InputError if a value is not one of the known names."""
    words = tuple(known)
    if not isinstance(value, str) or value not in words:
        raise InputError(f"unknown {what} {shown(value)}; known: {', '.join(words)}")


def as_numbers(
    value: Any, what: str, shape: Lengths, of: str = "", *, finite: bool = False
) -> NDArray[Any]:
    """Return a value as an array of real numbers; None in the shape is any length.

    Masked elements, and None among numbers, become NaN. Raises an InputError for other
    shapes, for anything but real numbers, and for NaN or infinity if ``finite``.
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
        wanted = f"numbers of shape {_told(shape)}" if shape else "a number"
        raise InputError(f"{what} is {shown(value)}, expected {wanted}{of}")
    if len(array.shape) != len(shape) or any(
        length not in (None, given)
        for length, given in zip(shape, array.shape, strict=True)
    ):
        raise InputError(f"{what} has shape {array.shape}, expected {_told(shape)}{of}")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{what} has NaN or infinite values; give finite numbers")
    return array


def _told(shape: Lengths) -> str:
    return str(shape).replace("None", "any")


def as_number(value: Any, what: str) -> float:
    """Return a value as a number, or raise an InputError."""
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
    """Convert fields of a frozen dataclass to double-precision arrays, in place.

    Fields named in ``keep`` keep their type. Raises an InputError as ``as_numbers``.
    """
    for name, shape in expected.items():
        given, where = getattr(value, name), f"{what}: {name}"
        array = as_numbers(given, where, shape, of, finite=finite)
        if name not in keep:
            array = array.astype(float, copy=False)
        object.__setattr__(value, name, array)


def freeze(value: Any) -> None:
    """Replace every array field of a frozen dataclass by a read-only view of it."""
    for field in fields(value):
        array = getattr(value, field.name)
        if isinstance(array, np.ndarray):
            object.__setattr__(value, field.name, read_only(array))
