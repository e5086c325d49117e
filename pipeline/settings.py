"""How a take is read, cleaned and written, and a fingerprint of these settings."""

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

_PARTS = ("{name}", "{sensor}")  # of a pattern of sessions


@dataclass(frozen=True)
class Settings:
    """How a take is read, cleaned and written."""

    config: CleanConfig = field(default_factory=CleanConfig)
    export: Export = field(default_factory=Export)
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""
    take_fps: float | None = None
    """Frames a second of a take that has no time stamps, as of MediaPipe, FreeMoCap and
    OpenPose; default: 30."""
    body: int | Literal["all"] | None = None
    """Which person, counted from 1 in order of appearance, or all: a clip each,
    clip.1.usda, clip.2.usda and so on; default: the person seen in most frames."""
    calibration: Path | None = None
    """Where and when several sensors are, as of 'merge --save-calibration'."""
    sessions: Suppress[str | None] = None
    """Pattern of the names of takes that are of one session (``batch/sessions.py``)."""
    sensors: Suppress[tuple[str, ...]] = ()
    """Names of their sensors, in order; default: whatever there is, by the alphabet."""

    def __post_init__(self) -> None:
        if self.sessions and any(self.sessions.count(part) != 1 for part in _PARTS):
            raise InputError(
                f"--sessions {self.sessions}: expected {' and '.join(_PARTS)} once "
                "each, such as {name}_{sensor}.csv* for walk_left.csv"
            )
        if len(set(self.sensors)) != len(self.sensors) or len(self.sensors) == 1:
            raise InputError(
                f"--sensors {' '.join(self.sensors)}: expected two or more, each once"
            )

    def read(self, path: Path) -> Recording:
        """Read a take as the settings say; raises InputError as ``read_recording``."""
        return read_recording(path, format=self.format, fps=self.take_fps)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the settings name, whether they exist or not."""
        parts = (self.config, self.export)
        values = [getattr(part, f.name) for part in parts for f in fields(part)]
        values += [*self.config.same_person, self.calibration]
        return tuple(Path(value) for value in values if names_file(value))


def fingerprint(settings: Settings, suffix: str) -> str:
    """Return a hash of all that decides the bytes of a clip, apart from the take.

    Files that the settings name count by their content, not by their path. ``suffix``
    is the extension of the clip, such as ``.usdc``. Raises an InputError if a file that
    the settings name does not exist.
    """
    known = asdict(settings)
    known |= {"suffix": suffix, "kinefilter": version("kinefilter")}
    text = json.dumps(known, sort_keys=True, default=hash_of)
    names = (settings.config.scene, settings.export.rig)
    files = [hash_of(Path(name)) for name in names if names_file(name)]
    return hashlib.sha256("\n".join([text, *files]).encode()).hexdigest()[:32]


def hash_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, or raise an InputError."""
    try:
        with check_file(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: cannot be read ({reason}); check its name"
        ) from error


def names_file(value: object) -> TypeGuard[str | Path]:
    """Tell files, also of scenes and rigs, from other settings."""
    if isinstance(value, str):
        return Path(value).suffix in (".xml", ".toml")
    return isinstance(value, Path)
