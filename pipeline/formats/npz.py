"""Arrays in npz files, none larger than the file says and none too large."""

from __future__ import annotations

import os
import zipfile
import zlib
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from kinefilter.characters import InputError

from .files import check_file

_LARGEST = 2**31
"""Bytes of all arrays: nine hours of the largest skeleton's positions."""
_KINDS = "biufUS"  # truth values, numbers and text
_MOST_ARRAYS = 1000
_LONGEST_HEADER = 10_000  # bytes, numpy's own limit for files from elsewhere


def array_names(path: str | os.PathLike[str]) -> set[str]:
    """Return the names of the arrays in an npz file.

    Raises:
        InputError: The file is missing or no zip archive.
    """
    source = os.fspath(check_file(path))
    try:
        with zipfile.ZipFile(source) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise _unreadable(source, error, "a file that kinefilter wrote") from None


def read_arrays(
    path: str | os.PathLike[str], expected: str = "a file that kinefilter wrote"
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz file, without running anything in it.

    The sizes that the archive and the arrays claim are compared before memory is
    given, so that a small file cannot ask for much.

    Args:
        path: The file.
        expected: What it should be, for messages.

    Raises:
        InputError: The file is missing, damaged, holds objects, or more than 2 GB.
    """
    source = os.fspath(check_file(path))
    try:
        with zipfile.ZipFile(source) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > _LARGEST or len(members) > _MOST_ARRAYS:
                raise InputError(
                    f"{source}: {len(members)} arrays of {size / 1e6:.0f} MB are more "
                    "than kinefilter writes; is it the right file?"
                )
            return {
                member.filename.removesuffix(".npy"): _array(archive, member)
                for member in members
            }
    except InputError:
        raise
    except (
        *(OSError, EOFError, ValueError, TypeError, MemoryError, OverflowError),
        *(zipfile.BadZipFile, zlib.error, NotImplementedError, SyntaxError),
        RuntimeError,  # an archive with a password
    ) as error:
        raise _unreadable(source, error, expected) from None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        _check_header(file, member.file_size)
    with archive.open(member) as file:
        array = npy.read_array(file, allow_pickle=False)
    return np.asarray(array)


def _check_header(file: IO[bytes], size: int) -> None:
    """Raise ValueError if an array would be larger than the archive holds of it."""
    version = npy.read_magic(file)
    read = {
        (1, 0): npy.read_array_header_1_0,
        (2, 0): npy.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"version {version}")
    shape, _, dtype = read(file, max_header_size=_LONGEST_HEADER)
    needed = dtype.itemsize
    for length in shape:
        needed *= max(length, 0)
    if needed > size or dtype.kind not in _KINDS:
        raise ValueError("larger than the archive says, or no numbers or text")


def _unreadable(source: str, error: Exception, expected: str) -> InputError:
    return InputError(
        f"{source}: cannot be read as npz ({type(error).__name__}); expected {expected}"
    )
