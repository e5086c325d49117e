"""The arrays that functions take and return, and arrays that nobody may change."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

Array = NDArray[np.float64]
"""Numbers in double precision; docstrings say their quantity, unit, frame and shape."""

Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
"""Truths, and indices of joints, frames or points."""

Number = TypeVar("Number", bound=np.generic)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return a view of an array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


def check_shapes(
    value: Any, what: str, expected: dict[str, tuple[int, ...]], of: str = ""
) -> None:
    """Raise an InputError if arrays of a value have other shapes than expected."""
    for name, shape in expected.items():
        found = np.shape(getattr(value, name))
        if found != shape:
            raise InputError(f"{what}: {name} has shape {found}, expected {shape}{of}")


def freeze(value: Any) -> None:
    """Make every array field of a frozen dataclass a read-only view of itself."""
    for field in fields(value):
        array = getattr(value, field.name)
        if isinstance(array, np.ndarray):
            object.__setattr__(value, field.name, read_only(array))
