"""Where takes are and clips go: a folder, or a URL that fsspec knows."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from .local import LocalStore
from .remote import RemoteStore, kind_of_url
from .store import Store, is_url


def store_at(place: str) -> Store:
    """Return the store whose root is a path or URL.

    Raises:
        InputError: The URL's protocol needs a package that is not installed.
    """
    if not is_url(place):
        return LocalStore(str(Path(place).absolute()))
    return RemoteStore(place.rstrip("/"))


def kind_of(place: str) -> Literal["file", "folder"] | None:
    """Return what a path or URL is of.

    Raises:
        InputError: As ``store_at``.
    """
    if is_url(place):
        return kind_of_url(place)
    if Path(place).is_dir():
        return "folder"
    return "file" if Path(place).is_file() else None
