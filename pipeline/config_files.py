"""Settings from TOML files, named like the options of the command line.

A file holds what ``clean`` has options for, such as ``method = "local-pca"``,
``cutoff = 4.0`` or ``rotation-order = "xyz"``. Paths in it are relative to its folder.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from kinefilter.characters import InputError

from .config import CleanConfig
from .field_types import converted, type_hints
from .formats.export import Export
from .formats.files import LARGEST_TOML, parse_toml, read_limited
from .settings import Settings, names_file

FOLDER_FILE = "kinefilter.toml"
"""Name of a file of settings for the takes in its folder."""
_PARTS: dict[str, type[Any]] = {"config": CleanConfig, "export": Export}
_OWN = {k: hint for k, hint in type_hints(Settings).items() if k not in _PARTS}
_HINTS = type_hints(CleanConfig) | type_hints(Export) | _OWN
_HINTS.pop("blender")  # a file beside takes must not choose a program to run


class SettingsFile(NamedTuple):
    """The path or URL of a file, and its values for fields of the settings."""

    name: str
    values: Mapping[str, Any]


def read_settings(path: str | os.PathLike[str]) -> SettingsFile:
    """Read a file of settings; raises InputError if it is missing or invalid."""
    text = read_limited(path, LARGEST_TOML)
    return parse_settings(text, os.fspath(path), Path(path).parent)


def parse_settings(text: str, name: str, folder: Path | None) -> SettingsFile:
    """Return the settings in TOML text; raises InputError if it is invalid.

    Paths in it are relative to the folder; without one, they must be absolute.
    """
    expected = "write lines such as cutoff = 4.0"
    return settings_in(parse_toml(text, name, expected), name, folder)


def settings_in(
    table: Mapping[str, Any], name: str, folder: Path | None
) -> SettingsFile:
    """Return the settings in a table; arguments and errors as for parse_settings."""
    values = {}
    for key, value in table.items():
        field = key.replace("-", "_")
        if field not in _HINTS:
            known = ", ".join(sorted(name.replace("_", "-") for name in _HINTS))
            raise InputError(f"{name}: unknown key {key!r}; known: {known}")
        where = f"{name}: {key}"
        values[field] = _absolute(converted(value, _HINTS[field], where), where, folder)
    return SettingsFile(name, values)


def as_table(settings: Settings) -> dict[str, Any]:
    """Return a table, for JSON, of the settings that are not the defaults."""
    table: dict[str, Any] = {}
    for part, default in (
        (settings, Settings()),
        (settings.config, CleanConfig()),
        (settings.export, Export()),
    ):
        for name, value in vars(part).items():
            if name in _HINTS and value != getattr(default, name):
                table[name] = _plain(value)
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return str(value.absolute()) if isinstance(value, Path) else value


def overlaid(
    settings: Settings, files: Sequence[SettingsFile], given: Collection[str]
) -> Settings:
    """Return settings changed by files, later ones overriding earlier ones.

    The fields ``given`` by the user stay. Raises InputError for an impossible value.
    """
    for file in files:
        values = {k: v for k, v in file.values.items() if k not in given}
        own = {name: value for name, value in values.items() if name in _OWN}
        try:
            for part, kind in _PARTS.items():
                names = {f.name for f in fields(kind)} & values.keys()
                changes = {name: values[name] for name in names}
                own[part] = replace(getattr(settings, part), **changes)
            settings = replace(settings, **own)
        except InputError as error:
            raise InputError(f"{file.name}: {error}") from None
    return settings


def _absolute(value: Any, where: str, folder: Path | None) -> Any:
    """Return a value with its paths made absolute."""
    if isinstance(value, tuple):
        return tuple(_absolute(one, where, folder) for one in value)
    if not names_file(value):
        return value
    if folder is None and not Path(value).is_absolute():
        raise InputError(
            f"{where} = {str(value)!r}: expected an absolute path, valid on every "
            "worker, as this file is in a store"
        )
    return type(value)(Path(folder or "", value).absolute())
