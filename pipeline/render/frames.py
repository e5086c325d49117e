"""Numbered PNG files that a later run goes on from."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

from .codec import encode_png

_HEADER = 8 + 25  # bytes of the signature and the first chunk
_KEY = b"kinefilter\0"
_NUMBER = re.compile(r"%0?\d*d")


def is_numbered(name: str) -> bool:
    """Tell whether a file's name has a place for a number, such as %05d."""
    return len(_NUMBER.findall(name)) == 1 and name.count("%") == 1


def frame_path(pattern: Path, number: int) -> Path:
    """Return the file of a frame, by its number from 0."""
    return pattern.with_name(pattern.name % number)


def write_frame(picture: NDArray[np.uint8], path: Path, fingerprint: str) -> None:
    """Write a picture, whole or not at all, and what it is a picture of.

    Raises:
        InputError: It cannot be written.
    """
    data = encode_png(picture)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data[:_HEADER] + _note(fingerprint) + data[_HEADER:])


def is_drawn(path: Path, fingerprint: str) -> bool:
    """Tell whether a file is the picture that would be drawn into it.

    Raises:
        InputError: It cannot be read.
    """
    note = _note(fingerprint)
    try:
        with path.open("rb") as file:
            return file.read(_HEADER + len(note))[_HEADER:] == note
    except FileNotFoundError:
        return False
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def _note(text: str) -> bytes:
    """Return a chunk of text (PNG specification, 11.3.3.2)."""
    body = b"tEXt" + _KEY + text.encode("latin-1")
    return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
