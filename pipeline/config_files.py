"""Settings in TOML files: the names are those of the command line's flags.

A file holds what ``clean`` has flags for, such as ``method = "local-pca"``,
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
"""Name of the file with the settings for the takes of its folder."""

_Part = CleanConfig | Export
_PARTS: dict[str, type[_Part]] = {"config": CleanConfig, "export": Export}
_OWN = {k: hint for k, hint in type_hints(Settings).items() if k not in _PARTS}
_HINTS = type_hints(CleanConfig) | type_hints(Export) | _OWN
_HINTS.pop("blender")  # no file that lies beside takes may say what program is run


class SettingsFile(NamedTuple):
    """A file's path or URL, and its values of the fields of the settings."""

    name: str
    values: Mapping[str, Any]


def read_settings(path: str | os.PathLike[str]) -> SettingsFile:
    """Read a file of settings; raises as ``parse_settings``, and if there is none."""
    text = read_limited(path, LARGEST_TOML)
    return parse_settings(text, os.fspath(path), Path(path).parent)


def parse_settings(text: str, name: str, folder: Path | None) -> SettingsFile:
    """Return the settings in the TOML of a file, or raise an InputError.

    Paths in it are relative to the folder; without one, they have to be absolute.
    """
    values = {}
    table = parse_toml(text, name, "write lines such as cutoff = 4.0")
    for key, value in table.items():
        field = key.replace("-", "_")
        if field not in _HINTS:
            known = ", ".join(sorted(name.replace("_", "-") for name in _HINTS))
            raise InputError(f"{name}: unknown key {key!r}; known: {known}")
        where = f"{name}: {key}"
        values[field] = _placed(converted(value, _HINTS[field], where), where, folder)
    return SettingsFile(name, values)


def overlaid(
    settings: Settings, files: Sequence[SettingsFile], given: Collection[str]
) -> Settings:
    """Return settings with the values of files, of which later ones override earlier.

    No file may change the fields ``given`` by the user. Raises an InputError if a file
    sets an impossible value.
    """
    for file in files:
        values = {k: v for k, v in file.values.items() if k not in given}
        own = {name: value for name, value in values.items() if name in _OWN}
        try:
            for part, kind in _PARTS.items():
                named = {f.name for f in fields(kind)} & values.keys()
                changed = {name: values[name] for name in named}
                own[part] = replace(getattr(settings, part), **changed)
            settings = replace(settings, **own)
        except InputError as error:
            raise InputError(f"{file.name}: {error}") from None
    return settings


def _placed(value: Any, where: str, folder: Path | None) -> Any:
    """Return a value with the absolute path of each file that it names."""
    if isinstance(value, tuple):
        return tuple(_placed(one, where, folder) for one in value)
    if not names_file(value):
        return value
    if folder is None and not Path(value).is_absolute():
        raise InputError(
            f"{where} = {str(value)!r}: expected an absolute path, since this file is "
            "in a store, and every worker must find the path on its disk"
        )
    return type(value)(Path(folder or "", value).absolute())
