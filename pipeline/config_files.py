"""Settings in TOML files: the names are those of the command line's flags.

A file holds what ``clean`` has flags for, such as ``method = "local-pca"``,
``cutoff = 4.0`` or ``rotation-order = "xyz"``. Paths in it are relative to its folder.
"""

from __future__ import annotations

import os
import types
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from kinefilter.characters import InputError

from .config import CleanConfig
from .formats.export import Export
from .formats.files import LARGEST_TOML, parse_toml, read_limited
from .settings import Settings, names_file

FOLDER_FILE = "kinefilter.toml"
"""Name of the file that says how the takes of its folder are cleaned."""


_OWN = {
    name: hint
    for name, hint in get_type_hints(Settings).items()
    if name not in ("config", "export")
}
_HINTS = get_type_hints(CleanConfig) | get_type_hints(Export) | _OWN
_WORDS = {
    Path: "the path of a file",
    str: "text",
    bool: "true or false",
    float: "a number",
    int: "a whole number",
}


@dataclass(frozen=True)
class SettingsFile:
    """What one file says."""

    name: str
    """Where it is, for messages."""
    values: Mapping[str, Any]
    """Values of the fields of ``CleanConfig``, ``Export`` and ``Settings``."""


def read_settings(path: str | os.PathLike[str]) -> SettingsFile:
    """Read a file of settings.

    Raises:
        InputError: There is no such file, or as ``parse_settings``.
    """
    text = read_limited(path, LARGEST_TOML)
    return parse_settings(text, os.fspath(path), Path(path).parent)


def parse_settings(text: str, name: str, folder: Path | None) -> SettingsFile:
    """Return what the text of a file says.

    Args:
        text: TOML.
        name: Where it is, for messages.
        folder: What paths in it are relative to; None: they have to be absolute.

    Raises:
        InputError: It is no TOML, a key is unknown, or a value of a wrong type.
    """
    table = parse_toml(text, name, "write lines such as cutoff = 4.0")
    values = {}
    for key, value in table.items():
        field = key.replace("-", "_")
        if field not in _HINTS:
            raise InputError(f"{name}: unknown key {key!r}; known: {_known()}")
        values[field] = _converted(value, field, f"{name}: {key}", folder)
    return SettingsFile(name, values)


def overlaid(
    settings: Settings, files: Sequence[SettingsFile], given: Collection[str]
) -> Settings:
    """Return settings with what files say; the later file is the stronger.

    Args:
        settings: What holds where no file says anything.
        files: The files, the strongest last.
        given: Names of fields that no file may change, as the user gave them.

    Raises:
        InputError: A file says something impossible.
    """
    for file in files:
        values = {k: v for k, v in file.values.items() if k not in given}
        try:
            settings = replace(
                settings,
                config=replace(settings.config, **_of(CleanConfig, values)),
                export=replace(settings.export, **_of(Export, values)),
                **{name: value for name, value in values.items() if name in _OWN},
            )
        except InputError as error:
            raise InputError(f"{file.name}: {error}") from None
    return settings


def _of(kind: type[CleanConfig | Export], values: Mapping[str, Any]) -> dict[str, Any]:
    return {f.name: values[f.name] for f in fields(kind) if f.name in values}


def _known() -> str:
    return ", ".join(sorted(name.replace("_", "-") for name in _HINTS))


def _converted(value: object, field: str, where: str, folder: Path | None) -> Any:
    """Return a value as its field has it."""
    kinds = _kinds(_HINTS[field])
    for kind in kinds:
        if get_origin(kind) is Literal:
            if isinstance(value, str) and value in get_args(kind):
                return value
        elif kind is float and type(value) in (int, float):
            return float(value)  # type: ignore[arg-type]  # checked in this line
        elif kind is Path and isinstance(value, str):
            return _placed(value, where, folder)
        elif type(value) is kind:
            if isinstance(value, str) and names_file(value):
                return str(_placed(value, where, folder))
            return value
    allowed = " or ".join(_described(kind) for kind in kinds)
    raise InputError(f"{where} = {value!r}: expected {allowed}")


def _kinds(hint: Any) -> list[Any]:
    """Return the types that a field may have; a file leaves out what is None."""
    union = get_origin(hint) in (Union, types.UnionType)
    kinds = get_args(hint) if union else (hint,)
    return [kind for kind in kinds if kind is not type(None)]


def _described(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return ", ".join(f'"{word}"' for word in get_args(kind))
    return _WORDS[kind]


def _placed(path: str, where: str, folder: Path | None) -> Path:
    if folder is None and not Path(path).is_absolute():
        raise InputError(
            f"{where} = {path!r}: expected an absolute path, as this file is in a "
            "store, and what it names has to be on the disk of every worker"
        )
    return Path(path) if folder is None else (folder / path).absolute()
