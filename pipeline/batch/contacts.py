"""Contacts in a batch: a file of them is of one person in one take."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.settings import Settings

from .sources import Source, is_take


def check_contacts(planned: Iterable[tuple[Source, Settings]]) -> None:
    """Raise an InputError if a file of contacts would be used for several people.

    Args:
        planned: Files, and what is done with each.
    """
    takes: dict[Path, str] = {}
    for source, settings in planned:
        file = settings.config.contacts
        if file is None or not _is_take(source, settings):
            continue
        if settings.body == "all":
            raise InputError(f"--contacts {file}: is of one person; give --body theirs")
        if file in takes:
            raise InputError(
                f"--contacts {file}: is of one take, not of {takes[file]} and "
                f"{source.take}; say it in a kinefilter.toml beside that take alone, "
                "or use 'kinefilter clean'"
            )
        takes[file] = source.take


def _is_take(source: Source, settings: Settings) -> bool:
    """Tell takes from other files; of one that cannot be read its row will tell."""
    try:
        with source.store.reading(source.file.name) as path:
            return is_take(source, path, settings.format)
    except InputError:
        return False
