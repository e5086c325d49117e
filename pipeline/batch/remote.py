"""Stores that fsspec reaches: ``s3://``, ``gs://``, ``file://`` and others.

fsspec is imported where it is used: it comes with the extra ``cluster``.
"""

from __future__ import annotations

import tempfile
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.settings import hash_of

from .store import Found

_WHOLE_PUTS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss"})
"""Object stores: what is put there appears whole, and there is no renaming."""
_TAGS = ("ETag", "etag", "md5", "mtime", "LastModified", "last_modified", "updated")
"""What file systems say of a file's last change, the surest first."""


@dataclass(frozen=True)
class RemoteStore:
    """A folder of a file system that fsspec knows."""

    root: str
    """URL without a slash at its end."""

    def path(self, name: str) -> str:
        """Return the URL of a file."""
        return f"{self.root}/{name}"

    def files(self) -> Iterator[Found]:
        """Yield what is below the root, hidden files and folders left out."""
        system, root = _system(self.root)
        with _told(self.root):
            # Folder by folder: a listing of everything may not fit the memory.
            for folder, folders, files in system.walk(root, detail=True):
                for name in [name for name in folders if name[0] == "."]:
                    del folders[name]
                inside = PurePosixPath(str(folder).removeprefix(root).strip("/"))
                for name in sorted(files):
                    if name[0] != ".":
                        yield _found((inside / name).as_posix(), files[name])

    def found(self, name: str) -> Found | None:
        """Return a file if it is there."""
        system, root = _system(self.root)
        with _told(self.path(name)):
            try:
                return _found(name, system.info(f"{root}/{name}"))
            except FileNotFoundError:
                return None

    def sha256(self, name: str) -> str:
        """Return the hash of a file's bytes."""
        with self.reading(name) as path:
            return hash_of(path)

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield a copy of a file."""
        system, root = _system(self.root)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / PurePosixPath(name).name
            with _told(self.path(name)):
                system.get_file(f"{root}/{name}", str(copy))
            yield copy

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield a path beside nothing else; what is there then is put in its place."""
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / PurePosixPath(name).name
            yield copy
            with _told(self.path(name)):
                self._put(copy, name)

    def put(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all."""
        with self.writing(name) as path:
            path.write_bytes(data)

    def _put(self, copy: Path, name: str) -> None:
        system, root = _system(self.root)
        target = f"{root}/{name}"
        if self.root.partition("://")[0] in _WHOLE_PUTS:
            system.put_file(str(copy), target)
            return
        parent, _, last = target.rpartition("/")
        temporary = f"{parent}/.{uuid.uuid4().hex}.{last}"
        system.makedirs(parent, exist_ok=True)
        try:
            system.put_file(str(copy), temporary)
            system.mv(temporary, target)
        except BaseException:
            if system.exists(temporary):
                system.rm_file(temporary)
            raise


def kind_of_url(url: str) -> Literal["file", "folder"] | None:
    """Return what a URL is of.

    Raises:
        InputError: The protocol is unknown or needs a package that is not installed.
    """
    system, root = _system(url)
    with _told(url):
        if system.isdir(root):
            return "folder"
        return "file" if system.isfile(root) else None


def _system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and its path there."""
    require("fsspec", f"the URL {url}", "cluster")
    from fsspec.core import url_to_fs

    try:
        system, root = url_to_fs(url)
    except (ImportError, ValueError) as error:
        # fsspec names the package: "Install s3fs to access S3".
        raise InputError(f"{url}: cannot be reached ({error})") from None
    return system, str(root).rstrip("/")


@contextmanager
def _told(url: str) -> Iterator[None]:
    """Turn whatever a file system raises into an InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # every protocol has errors of its own
        raise InputError(
            f"{url}: the store refused ({type(error).__name__}: {error}); check the "
            "address and your rights"
        ) from error


def _found(name: str, info: Mapping[str, Any]) -> Found:
    tag = next((str(info[key]) for key in _TAGS if info.get(key) is not None), "")
    size = int(info.get("size") or 0)
    # Without any tag it is never the same as before: then the content decides.
    return Found(name, size, f"{size}-{tag}" if tag else f"{size}-{uuid.uuid4().hex}")
