"""Files that appear whole or not at all, text that may be zipped, and TOML."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import sys
import tomllib
import uuid
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from kinefilter.characters import InputError
from kinefilter.characters.arrays import shown

AnyPath = str | os.PathLike[str]

_Limited = tuple[io.BufferedReader | gzip.GzipFile, int]  # and the most bytes of it
_GZIP_MAGIC = b"\x1f\x8b"

_LARGEST_TEXT = 2**30  # bytes: ten hours of Kinect v2 CSV; a recording is shorter
LARGEST_TOML = 2**16  # bytes of what somebody wrote by hand
_LARGEST_RATIO = 100
"""Text that is this many times as long as its gzip file, and longer than
``_ANY_RATIO``, is not a recording: numbers give 2 to 10. A guess."""
_ANY_RATIO = 2**25
_LONGEST_LINE = 1_000_000  # characters; a binary file may have no line end at all
_BEGINNING = 2**16  # bytes in which a text begins
_MOST_BLANK = 10_000  # lines in a row
_WINDOWS = sys.platform == "win32"
_UNUSABLE = re.compile(
    r'(con|prn|aux|nul|(com|lpt)\d)(\..*)?|.*[<>:"|?*].*|.*[ .]', re.IGNORECASE
)
"""Names of files that Windows takes for devices, for something else, or not at all."""
_LONGEST_PATH = 259  # characters, on Windows unless long paths are switched on


def check_folder(path: AnyPath) -> Path:
    """Return ``path`` if a file may be written there, else raise InputError."""
    path = as_path(path)
    if _WINDOWS and _UNUSABLE.fullmatch(path.name):
        raise InputError(f"{path}: Windows keeps such names to itself; give another")
    if not path.parent.is_dir():
        raise InputError(f"{path}: folder {path.parent} does not exist; create it")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: folder {path.parent} is read-only; write elsewhere")
    return path


def make_folder(path: Path) -> None:
    """Make a folder and those above it, or raise an InputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = f"cannot be made ({error.strerror})"
        raise InputError(f"{path}: {reason}; write elsewhere") from error


def as_path(path: AnyPath) -> Path:
    """Return a path that the system takes, or raise an InputError."""
    try:
        found = Path(path)
        found.is_dir()
    except (TypeError, OSError):  # no name at all, or one too long
        raise InputError(f"{shown(path)}: not the name of a file") from None
    return found


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its place on success.

    An older file stays as it was until then, and for good if the block raises. The
    temporary path ends in the same suffix. Raises InputError if it cannot be written.
    """
    target = check_folder(path)
    temporary = target.with_name(f".{uuid.uuid4().hex}{target.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        reason, hint = error.strerror or str(error), "write elsewhere or make room"
        if isinstance(error, PermissionError):  # Windows replaces no file that is open
            hint = "close it in other programs, or write elsewhere"
        elif _WINDOWS and len(str(temporary.absolute())) > _LONGEST_PATH:
            hint = "its path is too long; write elsewhere"
        raise InputError(f"{target}: cannot be written ({reason}); {hint}") from error
    finally:
        with suppress(OSError):  # not there, or still open after another error
            temporary.unlink()


@contextmanager
def new_text(path: AnyPath) -> Iterator[TextIO]:
    """Yield a text to write that takes the place of ``path`` on success."""
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        yield file


def check_file(path: AnyPath) -> Path:
    """Return ``path`` if there is a file to read, else raise InputError."""
    path = as_path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if not path.is_file():
        wrong = "there is no such file; check the name"
        if path.exists():  # opening it might wait forever
            wrong = "is a pipe, a socket or a device; give a file"
        elif path.is_symlink():
            wrong = "is a link to a file that is not there; restore or remove it"
        raise InputError(f"{path}: {wrong}")
    return path


@contextmanager
def open_text(path: AnyPath) -> Iterator[Iterator[str]]:
    """Yield the lines of a file of UTF-8 text, unzipped where it is gzip's.

    One line at a time is in memory. Raises InputError, also while the block reads, if
    the file is missing, unreadable, not UTF-8 text, too long, or a line has no end.
    """
    path = check_file(path)
    with _readable(path) as (stream, most):
        # utf-8-sig: spreadsheets put a byte-order mark in front.
        text = io.TextIOWrapper(stream, encoding="utf-8-sig")

        def lines() -> Iterator[str]:
            row = blank = size = 0
            while line := text.readline(_LONGEST_LINE):
                row, size = row + 1, size + len(line)
                blank = 0 if line.strip() else blank + 1
                wrong = ""
                if size > most:
                    raise _too_long(path, most)
                if "\0" in line:
                    wrong = "is binary; expected a text file, export it as CSV"
                elif blank > _MOST_BLANK:
                    wrong = "follows only blank rows; expected recorded frames"
                elif len(line) == _LONGEST_LINE:
                    wrong = "does not end; expected recorded frames"
                if wrong:
                    raise InputError(f"{path}: row {row} {wrong}")
                yield line

        yield lines()


def beginning(path: AnyPath, most: int = 100) -> str:
    """Return the first characters of a text, without leading blanks."""
    with _readable(check_file(path)) as (stream, _):
        return stream.read(_BEGINNING).decode("utf-8-sig", "ignore").lstrip()[:most]


def read_limited(path: AnyPath, most: int) -> str:
    """Return a file's text, unzipped; raises InputError beyond ``most`` bytes."""
    path = check_file(path)
    with _readable(path, most) as (stream, most):
        return _all(stream, path, most).decode("utf-8-sig")


def read_bytes(path: AnyPath, most: int) -> bytes:
    """Return what is in a file, unzipped; raises InputError beyond ``most`` bytes."""
    path = check_file(path)
    with _readable(path, most) as (stream, most):
        return _all(stream, path, most)


def _all(stream: io.BufferedReader | gzip.GzipFile, path: Path, most: int) -> bytes:
    data = stream.read(most + 1)
    if len(data) > most:
        raise _too_long(path, most)
    return data


def read_json(path: AnyPath, most: int, hook: Callable[[Any], Any]) -> Any:
    """Return what is in a file of JSON, whole numbers as floats.

    ``hook`` is json's for objects. Raises InputError if it is malformed or too long.
    """
    try:
        return json.loads(read_limited(path, most), object_hook=hook, parse_int=float)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}: row {error.lineno} is not JSON ({error.msg}); the file may be "
            "cut off, export it again"
        ) from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not JSON of a take; export it again") from None


def _too_long(path: Path, most: int) -> InputError:
    return InputError(f"{path}: more than {most / 1e6:.3g} MB; split it")


@contextmanager
def _readable(path: Path, most: int = _LARGEST_TEXT) -> Iterator[_Limited]:
    """Yield a file unzipped, and its most bytes; errors in it become InputErrors."""
    try:
        with path.open("rb") as raw:
            if raw.peek(2)[:2] != _GZIP_MAGIC:
                yield raw, most
                return
            ratio = _LARGEST_RATIO * path.stat().st_size
            with gzip.GzipFile(fileobj=raw) as stream:
                yield stream, min(most, max(_ANY_RATIO, ratio))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not UTF-8 text (byte 0x{error.object[error.start]:02x}); "
            "expected a text file, save it as CSV in UTF-8"
        ) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: damaged gzip ({error}); copy it again") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be read ({reason})") from error


def read_toml(path: AnyPath, expected: str) -> dict[str, Any]:
    """Return the table in a file as ``parse_toml``; raises InputError without one."""
    return parse_toml(read_limited(path, LARGEST_TOML), os.fspath(path), expected)


def parse_toml(text: str, name: str, expected: str) -> dict[str, Any]:
    """Return the table that TOML describes; raises InputError if it is malformed.

    ``name`` says where the text is and ``expected`` what to write instead.
    """
    try:
        return tomllib.loads(text)
    # Not its own error alone: numbers of thousands of digits, brackets in thousands.
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not TOML ({error}); {expected}") from None
