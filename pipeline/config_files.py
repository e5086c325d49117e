"""Settings in TOML files: the names are those of the command line's flags.

A file holds what ``clean`` has flags for, such as ``method = "local-pca"``,
``cutoff = 4.0`` or ``rotation-order = "xyz"``. Paths in it are relative to its folder.
"""

from __future__ import annotations

import os
import types
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from kinefilter.characters import InputError

from .config import CleanConfig
from .formats.export import Export
from .formats.files import LARGEST_TOML, parse_toml, read_limited
from .settings import Settings, names_file

FOLDER_FILE = "kinefilter.toml"
"""Name of the file with the settings for the takes of its folder."""

_Part = CleanConfig | Export
_PARTS: dict[str, type[_Part]] = {"config": CleanConfig, "export": Export}
_OWN = {k: hint for k, hint in get_type_hints(Settings).items() if k not in _PARTS}
_HINTS = get_type_hints(CleanConfig) | get_type_hints(Export) | _OWN
_WORDS = {
    Path: "the path of a file",
    str: "text",
    bool: "true or false",
    float: "a number",
    int: "a whole number",
}


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
        values[field] = _converted(value, field, f"{name}: {key}", folder)
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


def _converted(value: object, field: str, where: str, folder: Path | None) -> Any:
    hint = _HINTS[field]
    union = get_origin(hint) in (Union, types.UnionType)
    # A file leaves out what is None.
    kinds = [k for k in (get_args(hint) if union else (hint,)) if k is not type(None)]
    for kind in kinds:
        if get_origin(kind) is Literal:
            if isinstance(value, str) and value in get_args(kind):
                return value
        elif kind is float and type(value) in (int, float):
            return float(value)  # type: ignore[arg-type]  # checked in this line
        elif kind is Path and isinstance(value, str):
            return _placed(value, where, folder)
        elif get_origin(kind) is tuple and isinstance(value, list):
            if all(isinstance(name, str) for name in value):
                return tuple(_placed(name, where, folder) for name in value)
        elif type(value) is kind:
            if isinstance(value, str) and names_file(value):
                return str(_placed(value, where, folder))
            return value
    allowed = " or ".join(
        ", ".join(f'"{word}"' for word in get_args(kind)) or _WORDS[kind]
        for kind in kinds
    )
    raise InputError(f"{where} = {value!r}: expected {allowed}")


def _placed(path: str, where: str, folder: Path | None) -> Path:
    if folder is not None:
        return (folder / path).absolute()
    if not Path(path).is_absolute():
        raise InputError(
            f"{where} = {path!r}: expected an absolute path, since this file is in a "
            "store, and every worker must find the path on its disk"
        )
    return Path(path)
