"""Where takes are and clips go: a folder, or a URL that fsspec knows."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path
from kinefilter.pipeline.settings import hash_of

__all__ = ["Found", "LocalStore", "Store", "is_url", "kind_of", "real", "store_at"]

_TEMPORARY = 33  # characters of the stem of what ``atomic_path`` writes first


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

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""


def is_url(place: str) -> bool:
    """Tell a URL such as ``s3://bucket/folder`` from a path."""
    return "://" in place


def real(place: str) -> str:
    """Return a path without links, or a URL as it is, without a slash at the end."""
    return place.rstrip("/") if is_url(place) else str(Path(place).resolve())


def store_at(place: str) -> Store:
    """Return the store whose root is a path or URL.

    Raises:
        InputError: The URL's protocol needs a package that is not installed.
    """
    if not is_url(place):
        return LocalStore(str(Path(place).absolute()))
    from .remote import RemoteStore

    return RemoteStore(place.rstrip("/"))


def kind_of(place: str) -> Literal["file", "folder"] | None:
    """Return what a path or URL is of.

    Raises:
        InputError: As ``store_at``.
    """
    if is_url(place):
        from .remote import kind_of_url

        return kind_of_url(place)
    if Path(place).is_dir():
        return "folder"
    return "file" if Path(place).is_file() else None


@dataclass(frozen=True)
class LocalStore:
    """A folder of this machine, or one that it has mounted."""

    root: str
    """Absolute path."""

    def path(self, name: str) -> str:
        """Return where a file is."""
        return str(Path(self.root, name))

    def files(self) -> Iterator[Found]:
        """Yield what is below the root, hidden files and folders left out."""
        for folder, folders, names in os.walk(self.root, onerror=_refuse):
            folders[:] = sorted(name for name in folders if name[0] != ".")
            inside = Path(folder).relative_to(self.root)
            for name in sorted(names):
                found = self.found((inside / name).as_posix())
                if name[0] != "." and found is not None:
                    yield found

    def found(self, name: str) -> Found | None:
        """Return a file if it is there."""
        try:
            stat = Path(self.root, name).stat()
        except OSError:
            return None
        return Found(name, stat.st_size, f"{stat.st_size}-{stat.st_mtime_ns}")

    def sha256(self, name: str) -> str:
        """Return the hash of a file's bytes."""
        return hash_of(Path(self.root, name))

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield the file's own path."""
        yield Path(self.root, name)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield the file's own path: whoever writes does so whole or not at all."""
        path = Path(self.root, name)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{path.parent}: cannot be made ({error.strerror}); write elsewhere"
            ) from error
        yield path

    def put(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all."""
        with self.writing(name) as path, atomic_path(path) as temporary:
            temporary.write_bytes(data)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        Path(self.root, name).unlink(missing_ok=True)

    def remove_unfinished(self) -> None:
        """Remove what processes that were killed had begun to write."""
        for folder, _, names in os.walk(self.root):
            for name in names:
                if _is_unfinished(name):
                    Path(folder, name).unlink(missing_ok=True)


def _refuse(error: OSError) -> None:
    raise InputError(
        f"{error.filename}: cannot be searched ({error.strerror}); check its rights"
    ) from error


def _is_unfinished(name: str) -> bool:
    """Tell the names that ``atomic_path`` gives: a dot and a random number."""
    stem = name.partition(".")[2].partition(".")[0]
    if name[:1] != "." or len(stem) != _TEMPORARY - 1:
        return False
    try:
        return uuid.UUID(stem).version == 4
    except ValueError:
        return False
