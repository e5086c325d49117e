"""Settings for reading, cleaning and writing a take, and their fingerprint."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Literal, TypeGuard

from tyro.conf import Suppress

from kinefilter.characters import InputError

from .config import CleanConfig, TakeFormat
from .formats import Recording, read_recording
from .formats.export import Export
from .formats.files import check_file

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

    def read(self, path: Path) -> Recording:
        """Read a take with these settings; errors as for ``read_recording``."""
        return read_recording(path, format=self.format, fps=self.take_fps)

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
    ``.usdc``. Raises an InputError if a file does not exist.
    """
    known = asdict(settings)
    known |= {"suffix": suffix, "kinefilter": version("kinefilter")}
    text = json.dumps(known, sort_keys=True, default=hash_of)
    names = (settings.config.scene, settings.export.rig)
    files = [hash_of(Path(name)) for name in names if names_file(name)]
    return hashlib.sha256("\n".join([text, *files]).encode()).hexdigest()[:32]


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
