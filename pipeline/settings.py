"""Settings for reading, cleaning and writing a take, their files and fingerprint.

A file (TOML) holds what ``clean`` has options for, such as ``method = "local-pca"``,
``cutoff = 4.0`` or ``rotation-order = "xyz"``. Paths in it are relative to its folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import version
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeGuard

from tyro.conf import Suppress

from kinefilter.characters import InputError

from .config import CleanConfig, TakeFormat
from .field_types import converted, type_hints
from .formats import Recording, read_recording
from .formats.export import Export
from .formats.files import LARGEST_TOML, check_file, parse_toml, read_limited
from .progress import Progress, silent

if TYPE_CHECKING:
    from .clean_result import CleanResult
    from .cleaner import Cleaner
    from .merge import Merged

FOLDER_FILE = "kinefilter.toml"
"""Name of a file of settings for the takes in its folder."""
_PLACEHOLDERS = ("{name}", "{sensor}")  # in patterns of sessions


@dataclass(frozen=True)
class Settings:
    """Settings for reading, cleaning and writing a take."""

    config: CleanConfig = field(default_factory=CleanConfig)
    export: Export = field(default_factory=Export)
    format: TakeFormat | None = None
    """Layout of the take. By default it is detected from the content."""
    take_fps: float | None = None
    """Frame rate [Hz] of a take without time stamps, as from MediaPipe, FreeMoCap and
    OpenPose. The default is 30."""
    body: int | Literal["all"] | None = None
    """Which person to clean, counted from 1 in order of appearance, or all, for a clip
    each (clip.1.usda, ...); with --scene they share it and push each other. The default
    is the person seen in most frames."""
    calibration: Path | None = None
    """Alignment of several sensors, from 'merge --save-calibration'."""
    sessions: Suppress[str | None] = None
    """Pattern of the file names of a session's takes (``batch/sessions.py``)."""
    sensors: Suppress[tuple[str, ...]] = ()
    """Names of a session's sensors, in order; by default those found, sorted."""

    def __post_init__(self) -> None:
        pattern = self.sessions
        if pattern and any(pattern.count(part) != 1 for part in _PLACEHOLDERS):
            raise InputError(
                f"--sessions {pattern}: expected {' and '.join(_PLACEHOLDERS)} once "
                "each, such as {name}_{sensor}.csv* for walk_left.csv"
            )
        if len(set(self.sensors)) != len(self.sensors) or len(self.sensors) == 1:
            names = " ".join(self.sensors)
            raise InputError(f"--sensors {names}: expected two or more, each once")
        if self.config.gaps == "split" and (self.export.begin or self.export.end):
            raise InputError(
                "--gaps split cannot be combined with --begin or --end, which count "
                "from the take's first frame; leave it out, or write whole parts"
            )

    def read(self, path: Path) -> Recording:
        """Read a take with these settings; errors as for ``read_recording``."""
        return read_recording(path, format=self.format, fps=self.take_fps)

    def people(self, recordings: Sequence[Recording]) -> list[int]:
        """Return the numbers of the people to clean, one recording per sensor.

        Raises InputError if there is no such person, or all are asked for of a session.
        """
        first = recordings[0]
        if self.body != "all":
            return [first.main + 1 if self.body is None else self.body]
        if len(recordings) > 1:
            raise InputError(
                "--body all works with one sensor only; choose one person by number"
            )
        return list(range(1, len(first.takes) + 1))

    def left_out(self, recordings: Sequence[Recording]) -> Iterator[str]:
        """Yield a note if one of several people was chosen by default."""
        first, count = recordings[0], len(recordings[0].takes)
        if count > 1 and self.body is None and len(recordings) == 1:
            yield (
                f"cleaned body {first.main + 1} of {count}, the one seen in most "
                f"frames; choose another with --body 1 to {count}, or --body all"
            )

    def clean(
        self,
        recordings: Sequence[Recording],
        numbers: Sequence[int],
        cleaner: Cleaner | None = None,
        progress: Progress = silent,
    ) -> Iterator[tuple[int, CleanResult | InputError, Merged | None]]:
        """Yield each person's number, and the result or the error of cleaning them.

        Of several sensors' recordings, the merged take is yielded too. Several people
        share the tilt, and a ``scene``. ``cleaner`` is one with the same config.
        """
        from .cleaner import Cleaner

        first, config = recordings[0], self.config
        cleaner = cleaner or Cleaner(config)
        if len(numbers) > 1:
            takes = [first.take(number) for number in numbers]
            found = cleaner.clean_together(takes, progress=progress)
            yield from zip(numbers, found, repeat(None))
            return
        for number in numbers:
            result: CleanResult | InputError
            merged = None
            try:
                if len(recordings) == 1:
                    result = cleaner.clean(first.take(number), progress=progress)
                else:
                    from .merge import clean_session, read_calibration

                    result, merged = clean_session(
                        recordings,
                        config,
                        body=number,
                        calibration=read_calibration(self.calibration),
                        progress=progress,
                    )
            except InputError as error:
                result = error
            yield number, result, merged

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the settings name, existing or not."""
        parts = (self.config, self.export)
        values = [getattr(part, f.name) for part in parts for f in fields(part)]
        values += [*self.config.same_person, self.calibration]
        return tuple(Path(value) for value in values if names_file(value))


def fingerprint(settings: Settings, suffix: str) -> str:
    """Return a hash of everything but the take that decides the bytes of a clip.

    Files count by their content; ``suffix`` is the extension of the clip, such as
    ``.usdc``. Edits come last, after a dash, so that the rest can be compared without
    them. Raises an InputError if a file does not exist.
    """
    edits = settings.config.edits
    known = asdict(replace(settings, config=replace(settings.config, edits=None)))
    known |= {"suffix": suffix, "kinefilter": version("kinefilter")}
    text = json.dumps(known, sort_keys=True, default=hash_of)
    names = (settings.config.scene, settings.export.rig)
    files = [hash_of(Path(name)) for name in names if names_file(name)]
    hashed = hashlib.sha256("\n".join([text, *files]).encode()).hexdigest()[:32]
    return hashed if edits is None else f"{hashed}-{hash_of(edits)[:32]}"


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file's content; raises InputError if unreadable."""
    try:
        with check_file(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be read ({reason})") from error


def names_file(value: object) -> TypeGuard[str | Path]:
    """Return True if a setting is a file, including those of scenes and rigs."""
    if isinstance(value, str):
        return Path(value).suffix in (".xml", ".toml")
    return isinstance(value, Path)


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
    expected = "write lines such as cutoff = 4.0 or method = 'none'"
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
    settings: Settings, file: SettingsFile, given: Collection[str] = ()
) -> Settings:
    """Return settings changed by a file, except for the fields ``given`` by the user.

    Raises InputError for an impossible value.
    """
    values = {k: v for k, v in file.values.items() if k not in given}
    own = {name: value for name, value in values.items() if name in _OWN}
    try:
        for part, kind in _PARTS.items():
            names = {f.name for f in fields(kind)} & values.keys()
            changes = {name: values[name] for name in names}
            own[part] = replace(getattr(settings, part), **changes)
        return replace(settings, **own)
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None


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
