"""What a place is where takes are and clips go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Found:
    """A file in a store."""

    name: str
    """Path below the store's root, split by ``/``."""
    size: int
    """Bytes."""
    stamp: str
    """Changes whenever the file does: size, and time or tag of its last change."""


class Store(Protocol):
    """A folder with all that is below it; goes to other processes as it is."""

    @property
    def root(self) -> str:
        """Where it is."""

    def path(self, name: str) -> str:
        """Return where a file is, for messages."""

    def files(self) -> Iterator[Found]:
        """Yield what is below the root, hidden files and folders left out."""

    def found(self, name: str) -> Found | None:
        """Return a file if it is there."""

    def sha256(self, name: str) -> str:
        """Return the hash of a file's bytes."""

    def reading(self, name: str) -> AbstractContextManager[Path]:
        """Yield a path of this machine to read a file from."""

    def writing(self, name: str) -> AbstractContextManager[Path]:
        """Yield a path to write a file to, which appears whole or not at all.

        Folders are made. The writer must not leave half a file under the path.
        """

    def put(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all."""


def is_url(place: str) -> bool:
    """Tell a URL such as ``s3://bucket/folder`` from a path."""
    return "://" in place


def real(place: str) -> str:
    """Return a path without links, or a URL as it is, without a slash at the end."""
    return place.rstrip("/") if is_url(place) else str(Path(place).resolve())
