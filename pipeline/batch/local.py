"""A folder of this machine, where takes are or clips go."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path
from kinefilter.pipeline.settings import hash_of

from .store import Found

_TEMPORARY = 33  # characters of the stem of what ``atomic_path`` writes first


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
