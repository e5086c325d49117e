"""Folders that takes are read from and clips written to: local, or at fsspec URLs."""

import os
import re
import tempfile
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import atomic_path, make_folder
from kinefilter.pipeline.settings import hash_of

# A scheme has at least two letters; C: is a drive.
_URL = re.compile(r"[A-Za-z][\w+.:-]+://")
# Names of temporary files of ``atomic_path``: a dot and a random UUID.
_TEMPORARY = re.compile(r"\.[0-9a-f]{12}4[0-9a-f]{3}[89ab][0-9a-f]{15}(\..*)?")
_ATOMIC_PUTS = ("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss")
"""Object stores, in which uploads are atomic and renaming makes a copy."""
_TAGS = ("ETag", "etag", "md5", "mtime", "LastModified", "last_modified", "updated")
"""Keys under which file systems report a file's last change, most precise first."""


@dataclass(frozen=True, slots=True)
class StoredFile:
    """A file in a store."""

    name: str  # path below the store's root, separated by /
    size: int  # bytes
    stamp: str  # size, and time or tag of the last change; differs after any change


@dataclass(frozen=True)
class Store:
    """A local or mounted folder and all below it; can be sent to other processes."""

    root: str  # absolute path, or URL without a trailing slash
    is_local: ClassVar[bool] = True

    def path(self, name: str) -> str:
        """Return the path or URL of a file."""
        return f"{self.root.rstrip('/')}/{name}"

    def files(self) -> Iterator[StoredFile]:
        """Yield the files below the root, except hidden files and folders.

        A folder that cannot be searched is listed as FOLDER/*; if it is the root, an
        InputError is raised.
        """
        refused: list[OSError] = []
        for folder, folders, names in os.walk(self.root, onerror=refused.append):
            folders[:] = sorted(name for name in folders if name[0] != ".")
            inside = Path(folder).relative_to(self.root)
            for name in sorted(names):
                if name[0] != ".":
                    path = (inside / name).as_posix()
                    # List broken links too, so that they are reported as failed takes.
                    yield self.find(path) or StoredFile(path, 0, "")
        for error in refused:
            inside = Path(error.filename).relative_to(self.root)
            if not inside.parts:
                wrong = f"cannot be searched ({error.strerror}); check permissions"
                raise InputError(f"{self.root}: {wrong}") from error
            yield StoredFile(f"{inside.as_posix()}/*", 0, "")

    def find(self, name: str) -> StoredFile | None:
        """Return a file, or None if it does not exist."""
        try:
            stat = Path(self.root, name).stat()
        except OSError:
            return None
        return StoredFile(name, stat.st_size, f"{stat.st_size}-{stat.st_mtime_ns}")

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield a local path to read a file from."""
        yield Path(self.root, name)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield a local path to write a whole file to; create missing folders."""
        path = Path(self.path(name))  # not Path(root, name): name may look like a drive
        make_folder(path.parent)
        yield path

    def sha256(self, name: str) -> str:
        """Return the SHA-256 of a file."""
        with self.reading(name) as path:
            return hash_of(path)

    def put(self, name: str, data: bytes) -> None:
        """Write a file atomically."""
        with self.writing(name) as path, atomic_path(path) as temporary:
            temporary.write_bytes(data)


class _RemoteStore(Store):
    """A folder in a file system of fsspec."""

    is_local = False

    def files(self) -> Iterator[StoredFile]:
        system, root = _file_system(self.root)
        with _as_input_error(self.root):
            # Folder by folder, since a listing of everything may not fit into memory.
            for folder, folders, files in system.walk(root, detail=True):
                for name in [name for name in folders if name[0] == "."]:
                    del folders[name]
                inside = PurePosixPath(str(folder).removeprefix(root).strip("/"))
                for name in sorted(files):
                    if name[0] != ".":
                        yield _stored_file((inside / name).as_posix(), files[name])

    def find(self, name: str) -> StoredFile | None:
        system, root = _file_system(self.root)
        with _as_input_error(self.path(name)), suppress(FileNotFoundError):
            return _stored_file(name, system.info(f"{root}/{name}"))
        return None

    @contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        with self._local_copy(name) as (system, remote, copy):
            with _as_input_error(self.path(name)):
                system.get_file(remote, str(copy))
            yield copy

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        with self._local_copy(name) as (system, remote, copy):
            yield copy
            with _as_input_error(self.path(name)):
                if self.root.partition("://")[0] in _ATOMIC_PUTS:
                    system.put_file(str(copy), remote)
                    return
                parent = remote.rpartition("/")[0]
                temporary = f"{parent}/.{uuid.uuid4().hex}{PurePosixPath(name).suffix}"
                system.makedirs(parent, exist_ok=True)
                try:
                    system.put_file(str(copy), temporary)
                    system.mv(temporary, remote)
                except BaseException:
                    if system.exists(temporary):
                        system.rm_file(temporary)
                    raise

    @contextmanager
    def _local_copy(self, name: str) -> Iterator[tuple[Any, str, Path]]:
        """Yield a file's file system, its path there, and a temporary local path."""
        system, root = _file_system(self.root)
        with tempfile.TemporaryDirectory() as folder:
            yield system, f"{root}/{name}", Path(folder, PurePosixPath(name).name)


def remove_unfinished(store: Store) -> None:
    """Remove temporary files that killed processes left in a local store."""
    for folder, _, names in os.walk(store.root) if store.is_local else ():
        for name in names:
            if _TEMPORARY.fullmatch(name):
                with suppress(OSError):  # owned by another user, or gone
                    Path(folder, name).unlink()


def store_at(place: str) -> Store:
    """Return the store whose root is a path or URL."""
    if is_url(place):
        return _RemoteStore(place.rstrip("/"))
    return Store(str(Path(place).absolute()))


def is_url(place: str) -> bool:
    """Return True for a URL such as ``s3://bucket/folder``, not for a path."""
    return _URL.match(place) is not None


def is_folder(place: str) -> bool:
    """Return True if a path or URL is an existing folder."""
    if not is_url(place):
        return Path(place).is_dir()
    system, path = _file_system(place)
    with _as_input_error(place):
        return bool(system.isdir(path))


def canonical(place: str) -> str:
    """Return a path with links resolved, or a URL without a trailing slash."""
    return place.rstrip("/") if is_url(place) else Path(place).resolve().as_posix()


def _file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it.

    Raises InputError if the protocol is unknown, its package is not installed, or
    there is no answer.
    """
    require("fsspec", f"the URL {url}", "cluster")
    from fsspec.core import url_to_fs

    with _as_input_error(url):
        try:
            system, root = url_to_fs(url)
        except (ImportError, ValueError) as error:
            # fsspec names the package: "Install s3fs to access S3".
            raise InputError(f"{url}: cannot be reached ({error})") from None
    return system, str(root).rstrip("/")


@contextmanager
def _as_input_error(url: str) -> Iterator[None]:
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # every protocol has its own exceptions
        wrong = f"access failed ({type(error).__name__}: {error})"
        hint = "check the address and your permissions"
        raise InputError(f"{url}: {wrong}; {hint}") from error


def _stored_file(name: str, info: Mapping[str, Any]) -> StoredFile:
    # Without a tag, the stamp never matches, so that the content is compared.
    tags = (str(info[key]) for key in _TAGS if info.get(key) is not None)
    tag = next(tags, "") or uuid.uuid4().hex
    size = int(info.get("size") or 0)
    return StoredFile(name, size, f"{size}-{tag}")
