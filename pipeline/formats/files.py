"""Files: written whole or not at all, text that may be gzipped, JSON and TOML."""

import gzip
import io
import json
import os
import re
import struct
import sys
import tomllib
import uuid
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from tempfile import TemporaryFile
from tokenize import TokenError
from typing import Any, TextIO, TypeVar
from urllib.request import url2pathname

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, shown

AnyPath = str | os.PathLike[str]
_Path = TypeVar("_Path", bound=PurePath)

_Stream = io.BufferedReader | gzip.GzipFile
_GZIP_MAGIC = b"\x1f\x8b"
_FBX = (b"Kaydara FBX", b"; FBX ")  # beginnings of binary and of text files

_LARGEST_TEXT = 2**30  # bytes: ten hours of Kinect v2 CSV, longer than any recording
CALIBRATION = "kinefilter calibration"  # what a file of sensor alignments is
LARGEST_TOML = 2**16  # bytes of a handwritten file
_LARGEST_RATIO = 100
"""Compression ratio of gzipped text above which, beyond ``_ANY_RATIO`` bytes, it is not
a recording: numbers reach 2 to 10. A guess."""
_ANY_RATIO = 2**25
_LONGEST_LINE = 1_000_000  # characters; a binary file may have no line end at all
_BEGINNING = 2**16  # bytes read to find out what a file is
_MOST_BLANK = 10_000  # consecutive lines
_WINDOWS = sys.platform == "win32"
_UNUSABLE = re.compile(
    r'(con|prn|aux|nul|(com|lpt)\d)(\..*)?|.*[<>:"|?*].*|.*[ .]', re.IGNORECASE
)
"""Names that Windows reserves for devices, changes, or refuses."""
_FILE_URL = re.compile(r"((?:--[\w-]+=)?)file://(?:localhost)?(/.*)", re.DOTALL)
_NO_URLS = "only batch takes URLs; give a local path"
_LONGEST_PATH = 259  # characters, on Windows unless long paths are enabled
_DAMAGE = (
    *(ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, OSError),
    *(RuntimeError, StopIteration, SyntaxError, TypeError, ValueError),
    *(TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)
"""What the readers of numpy, zip, GLB and USD raise for damaged files."""


def check_folder(path: AnyPath) -> Path:
    """Return ``path`` if a file can be written there, else raise InputError.

    Its folder may be missing: ``atomic_path`` creates it.
    """
    path = as_path(path)
    if _WINDOWS and _UNUSABLE.fullmatch(path.name):
        raise InputError(f"{path}: Windows reserves such names; choose another")
    if _is_url(path):
        raise InputError(f"{path}: {_NO_URLS}")
    folder = next((p for p in path.parents if p.exists()), path.parent)
    if not folder.is_dir():
        wrong = "is a file; choose a folder" if folder.exists() else "does not exist"
        raise InputError(f"{path}: {folder} {wrong}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    try:
        with TemporaryFile(dir=folder):
            return path
    except OSError as error:
        reason = f"cannot be written ({error.strerror})"
        raise InputError(f"{path}: {reason}; write elsewhere") from error


def _is_url(path: Path) -> bool:
    return bool(path.parts and re.fullmatch(r"[A-Za-z][\w+.-]+:", path.parts[0]))


def make_folder(path: Path) -> None:
    """Create a folder and its parents; raises InputError if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = f"cannot be created ({error.strerror})"
        raise InputError(f"{path}: {reason}; write elsewhere") from error


def local_path(place: str) -> str:
    """Return the path that a ``file://`` URL names, and any other text as it is.

    An option may come before it, as in ``--out=file:///clips``.
    """
    found = _FILE_URL.fullmatch(place)
    return place if found is None else found[1] + url2pathname(found[2])


def as_path(path: AnyPath) -> Path:
    """Convert to a path that the system accepts, or raise InputError."""
    try:
        found = Path(path)
        found.is_dir()
    except TypeError:
        raise InputError(f"{shown(path)}: is not a valid file name") from None
    except OSError as error:  # too long, or in a folder without permission
        wrong = f"cannot be accessed ({error.strerror}); check its name and rights"
        raise InputError(f"{str(path)[:_LONGEST_PATH]}: {wrong}") from None
    return found


def numbered(path: _Path, body: int | None) -> _Path:
    """Return the path for one of several people: ``clip.2.usda`` for ``clip.usda``."""
    return path if body is None else path.with_name(f"{path.stem}.{body}{path.suffix}")


def part_paths(path: _Path, parts: int) -> list[_Path]:
    """Return a path per part of a take: ``clip.part1.usda`` and so on."""
    if parts == 1:
        return [path]
    names = (f"{path.stem}.part{k}{path.suffix}" for k in range(1, parts + 1))
    return [path.with_name(name) for name in names]


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that replaces it on success.

    Its folder is created if it is missing.
    If the block raises, an existing file stays as it was. The temporary path has the
    same suffix. Raises InputError if the file cannot be written.
    """
    target = check_folder(path)
    make_folder(target.parent)
    temporary = target.with_name(f".{uuid.uuid4().hex}{target.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        reason, hint = error.strerror or str(error), "write elsewhere or make room"
        if isinstance(error, PermissionError):  # Windows does not replace open files
            hint = "close it in other programs, or write elsewhere"
        elif _WINDOWS and len(str(temporary.absolute())) > _LONGEST_PATH:
            hint = "its path is too long; write elsewhere"
        raise InputError(f"{target}: cannot be written ({reason}); {hint}") from error
    finally:
        with suppress(OSError):  # not there, or still open after another error
            temporary.unlink()


@contextmanager
def refused(path: AnyPath, wrong: str) -> Iterator[None]:
    """Turn errors that a damaged file causes into InputErrors that name the file."""
    source = os.fspath(path)
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if source in text else f"{source}: {text}") from None
    except _DAMAGE:
        raise InputError(f"{source}: {wrong}") from None


@contextmanager
def new_text(path: AnyPath) -> Iterator[TextIO]:
    """Yield a text file to write that replaces ``path`` on success."""
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        yield file


def append_whole(file: io.FileIO, data: bytes) -> None:
    """Append data to an unbuffered file, on disk; after an OSError it is as before."""
    before, left = file.seek(0, os.SEEK_END), memoryview(data)
    try:
        while left:  # the system may write only a part at a time
            left = left[file.write(left) or 0 :]
        os.fsync(file.fileno())
    except OSError:
        file.truncate(before)  # possible even on a full disk
        raise


def check_file(path: AnyPath) -> Path:
    """Return ``path`` if it is a file that can be opened, else raise InputError."""
    path = as_path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if not path.is_file():
        wrong = "there is no such file; check the name"
        if _is_url(path):
            wrong = _NO_URLS
        elif path.exists():  # opening it might wait forever
            wrong = "is a pipe, a socket or a device; give a file"
        elif path.is_symlink():
            wrong = "is a link to a missing file; restore that file or remove the link"
        elif path.parent.is_dir() and not os.access(path.parent, os.R_OK | os.X_OK):
            wrong = "its folder cannot be searched; check permissions"
        raise InputError(f"{path}: {wrong}")
    if not os.access(path, os.R_OK):
        raise InputError(f"{path}: cannot be read; check permissions")
    return path


@contextmanager
def open_text(path: AnyPath) -> Iterator[Iterator[str]]:
    """Yield the lines of a UTF-8 text file, gzipped or not, one at a time in memory.

    Raises InputError, also while the lines are read, if the file is missing,
    unreadable, not UTF-8 text or too long, or has a line without end.
    """
    with _opened(path) as (stream, most):
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
                    wrong = "comes after nothing but blank rows; delete these"
                elif len(line) == _LONGEST_LINE:
                    wrong = "does not end; expected recorded frames"
                if wrong:
                    raise InputError(f"{path}: row {row} {wrong}")
                yield line

        yield lines()


def beginning(path: AnyPath, most: int = 100) -> str:
    """Return the first characters of a text file, without leading blanks."""
    with _opened(path) as (stream, _):
        return stream.read(_BEGINNING).decode("utf-8-sig", "ignore").lstrip()[:most]


def read_limited(path: AnyPath, most: int) -> str:
    """Read UTF-8 text, gzipped or not; raises InputError above ``most`` bytes."""
    with _opened(path, most) as (stream, most):
        return _all(stream, path, most).decode("utf-8-sig")


def read_bytes(path: AnyPath, most: int) -> bytes:
    """Read a file, gzipped or not; raises InputError above ``most`` bytes."""
    with _opened(path, most) as (stream, most):
        return _all(stream, path, most)


def _all(stream: _Stream, path: AnyPath, most: int) -> bytes:
    data = stream.read(most + 1)
    if len(data) > most:
        raise _too_long(path, most)
    return data


def _too_long(path: AnyPath, most: int) -> InputError:
    wrong = f"larger than the {most / 1e6:.3g} MB that such a file may have"
    return InputError(f"{path}: {wrong}; split it, or give another")


@contextmanager
def _opened(path: AnyPath, most: int = _LARGEST_TEXT) -> Iterator[tuple[_Stream, int]]:
    """Yield a file unzipped, and its size limit; errors in it become InputErrors."""
    path = check_file(path)
    try:
        with path.open("rb") as raw:
            if raw.peek(16).startswith(_FBX):
                raise InputError(f"{path}: FBX cannot be read; export it as BVH")
            if raw.peek(2)[:2] != _GZIP_MAGIC:
                yield raw, most
                return
            ratio = _LARGEST_RATIO * path.stat().st_size
            with gzip.GzipFile(fileobj=raw) as stream:
                yield stream, min(most, max(_ANY_RATIO, ratio))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not UTF-8 text (byte 0x{error.object[error.start]:02x}); save it "
            "as plain text in UTF-8"
        ) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: damaged gzip ({error}); copy it again") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be read ({reason})") from error


def read_json(path: AnyPath, most: int, hook: Any = None) -> Any:
    """Read a JSON file, whole numbers as floats; ``hook`` is json's ``object_hook``.

    Raises InputError if it is malformed or longer than ``most`` bytes.
    """
    try:
        return json.loads(read_limited(path, most), object_hook=hook, parse_int=float)
    except json.JSONDecodeError as error:
        raise InputError(
            f"{path}: row {error.lineno} is not JSON ({error.msg}); the file may be "
            "cut off, export it again"
        ) from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not JSON of a take; export it again") from None


def list_in(value: Any, key: str, where: str, tool: str) -> list[Any]:
    """Return the list ``key`` of a JSON object; raises InputError without one."""
    found = value.get(key) if isinstance(value, dict) else None
    if not isinstance(found, list):
        raise InputError(f"{where}: no list {key!r}; export it again with {tool}")
    return found


def number_in(value: Any, key: str, where: str, limit: float) -> float:
    """Return the number ``key`` of a JSON object; raises InputError without one."""
    found = value.get(key) if isinstance(value, dict) else None
    if not isinstance(found, float) or not abs(found) < limit:
        raise InputError(
            f"{where}: {key!r} is {shown(found)}, expected a number under {limit:g}"
        )
    return found


def array_of(values: Any) -> Array:
    """Convert nested lists of numbers to an array, anything else to an empty one."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.empty(0)


def read_toml(path: AnyPath, expected: str) -> dict[str, Any]:
    """Read a TOML file; raises InputError as ``parse_toml``."""
    return parse_toml(read_limited(path, LARGEST_TOML), os.fspath(path), expected)


def parse_toml(text: str, name: str, expected: str) -> dict[str, Any]:
    """Parse TOML from the place ``name``; an InputError tells what is ``expected``."""
    try:
        return tomllib.loads(text)
    # Also errors from numbers of thousands of digits or thousands of brackets.
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not TOML ({error}); {expected}") from None
