"""Files that appear whole or not at all, and text that may be zipped."""

from __future__ import annotations

import gzip
import io
import os
import uuid
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TextIO, cast

from kinefilter.characters import InputError

__all__ = ["atomic_path", "check_folder", "open_text"]

_GZIP_MAGIC = b"\x1f\x8b"


def check_folder(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` if a file may be written there.

    Raises:
        InputError: Its folder is missing or read-only, or it is a folder itself.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(
            f"{path}: folder {path.parent} does not exist; create it or write elsewhere"
        )
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not os.access(path.parent, os.W_OK):
        raise InputError(
            f"{path}: folder {path.parent} is not writable; write elsewhere"
        )
    return path


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its place on success.

    An older file stays as it was until then, and for good if the block raises. The
    temporary path ends in the same suffix, for writers that go by it.

    Raises:
        InputError: The folder is missing or read-only, or the system cannot write.
    """
    target = check_folder(path)
    temporary = target.with_name(f".{uuid.uuid4().hex}{target.suffix}")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{target}: cannot be written ({reason}); write elsewhere or make room"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def open_text(path: str | os.PathLike[str]) -> Iterator[TextIO]:
    """Yield a file's UTF-8 text, unzipped where its first bytes are gzip's.

    Whatever goes wrong while the block reads is raised as an InputError.

    Raises:
        InputError: There is no such file, it cannot be read, or it is not UTF-8 text.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    try:
        with path.open("rb") as raw:
            zipped = raw.peek(2)[:2] == _GZIP_MAGIC
            stream = gzip.GzipFile(fileobj=raw) if zipped else raw
            # utf-8-sig: spreadsheets put a byte-order mark in front.
            yield io.TextIOWrapper(cast("IO[bytes]", stream), encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the name") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not UTF-8 text (byte 0x{error.object[error.start]:02x}); "
            "expected a text file, save it as CSV in UTF-8"
        ) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: damaged gzip file ({error}); copy or download it again"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be read ({reason})") from error
