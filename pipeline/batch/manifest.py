"""The manifest of a batch: one line per cleaned take, never changed once written.

If a take has several lines, the last one counts. A killed run loses at most the lines
that it was writing; the next run drops an incomplete line and cleans those takes again.
In a folder, the lines are in one file. Remote stores cannot append to a file, so there
the lines are in parts of up to a thousand, the last of which is rewritten with every
row until it is full. Each run writes parts of its own, so that nothing is lost even if
two runs overlap, which should not happen.
"""

from __future__ import annotations

import csv
import io
import json
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock, Timeout

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import append_whole
from kinefilter.pipeline.formats.plain import finite

from .store import Store, store_at

_LINES, _PARTS = "manifest.jsonl", "manifest"  # a file; at a URL, a folder of files
_CSV = "manifest.csv"
_LOCK = "manifest.lock"
_LOCK_TIMEOUT = 0.5  # s; without native locks, a stale lock is removed first
_ROWS_PER_PART = 1000  # less than a megabyte

Status = Literal["done", "failed", "no take"]
"""Result for a file; of a failed take at least one clip is missing."""


@dataclass(frozen=True, slots=True)
class ClipRow:
    """A clip of one person, and its main figures; None if not measured."""

    output: str  # path below the output folder, separated by /
    stamp: str  # size and time of the file when it was written
    sha256: str
    body: int  # number of the person in the take, from 1
    frames: int
    motion_seconds: float
    jitter_raw: float | None  # of the take [m/s^3], see Quality
    jitter: float | None  # of the clip [m/s^3]
    skate_mm_per_frame: float | None  # mean, see Quality
    external_force_body_weights: float | None  # mean, see Clip.external_force
    share_outside_database: float | None  # of frames, with postures not in the database
    failures: int  # tracker failures, including displaced limbs
    notes: tuple[str, ...]  # messages for the user
    damage: tuple[str, ...] = ()  # of the take: a sentence for each, with its time
    unexplained_force_body_weights: float | None = None  # mean, beyond floor contact


@dataclass(frozen=True, slots=True)
class Row:
    """The result for a file or session."""

    take: str  # its name, see Source and Session
    status: Status
    output: str  # path of the clip below the output folder, without a person's number
    stamp: str  # size and time of the take's file when it was read
    sha256: str = ""  # of the take's file; empty if it could not be read
    settings: str = ""  # their fingerprint
    seconds: float = 0.0  # computing time
    clips: tuple[ClipRow, ...] = ()  # one per person or part
    error: str = ""  # why a clip is missing
    sensors: tuple[dict[str, Any], ...] = ()  # each one's take, and ``Merged.figures``
    options: dict[str, Any] = field(default_factory=dict)  # as in a ``kinefilter.toml``

    def as_json(self) -> str:
        """Return the row as a line of JSON, without a line break."""
        return json.dumps(finite(asdict(self)), allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Parse a line; raises ValueError if it is damaged or its version too old."""
        values = json.loads(line)
        try:
            # Rows of older versions lack damage, sensors and options.
            for clip in values["clips"]:
                clip |= {key: tuple(clip.get(key, ())) for key in ("notes", "damage")}
            values["clips"] = tuple(ClipRow(**clip) for clip in values["clips"])
            values["sensors"] = tuple(values.get("sensors", ()))
            return cls(**values)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"not a row of a manifest: {error}") from None


def _with_line(row: Row) -> tuple[Row, str]:
    """Return a row and its line, or those of a failed take if JSON cannot hold it."""
    try:
        return row, row.as_json()
    except (TypeError, ValueError) as refusal:
        error = f"its figures cannot be written as JSON ({refusal})"
        failed = Row(row.take, "failed", row.output, row.stamp, error=error)
        return failed, failed.as_json()


class Manifest:
    """The manifest of an output folder; ``rows`` has the last row of each take."""

    def __init__(self, file: io.FileIO, path: Path) -> None:
        rows, length = parse_rows(file.readall(), str(path))
        file.truncate(length)
        self._file, self._path = file, path
        self.rows = {row.take: row for row in rows}

    def append(self, rows: Iterable[Row]) -> list[Row]:
        """Write new rows to disk, and return them.

        A row that JSON cannot hold is replaced by that of a failed take. Raises
        InputError if the rows cannot be written.
        """
        new = [_with_line(row) for row in rows if row is not self.rows.get(row.take)]
        if new:
            self._write([line + "\n" for _, line in new])
            self.rows.update((row.take, row) for row, _ in new)
        return [row for row, _ in new]

    def _write(self, lines: Sequence[str]) -> None:
        try:
            append_whole(self._file, "".join(lines).encode())
        except OSError as error:
            wrong = f"cannot be written ({error.strerror})"
            hint = "free some space, and run the same command again to resume"
            raise InputError(f"{self._path}: {wrong}; {hint}") from error


@contextmanager
def open_manifest(store: Store) -> Iterator[Manifest]:
    """Yield the manifest of an output folder; both are created if missing.

    Raises InputError if another run is writing there, the folder is not writable, or a
    line other than the last is damaged.
    """
    if not store.is_local:
        yield _InParts(store)
        return
    path = Path(store.path(_LINES))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        file = path.open("rb+", buffering=0)
    except OSError as error:
        wrong = f"cannot be written ({error.strerror})"
        raise InputError(f"{path}: {wrong}; choose another folder") from error
    with file:
        try:
            # The system releases the lock when the process ends, however it ends.
            lock = FileLock(path.with_name(_LOCK)).acquire(_LOCK_TIMEOUT)
        except Timeout:
            raise InputError(
                f"{store.root}: another run is writing there; wait for it, or choose "
                "another folder"
            ) from None
        with lock:
            try:
                yield Manifest(file, path)
            finally:
                with suppress(OSError):  # Windows does not remove open files
                    path.with_name(_LOCK).unlink()


class _InParts(Manifest):
    """The manifest in a remote store: lines in several files."""

    def __init__(self, store: Store) -> None:
        self._store = store_at(f"{store.root}/{_PARTS}")
        self._lines: list[str] = []
        self._full_parts = 0
        # Parts are read in the order of their names; a later run comes last even if the
        # clock was set back.
        parts = sorted(file.name for file in self._store.files())
        last_run = int(parts[-1].partition("-")[0]) if parts else 0
        self._run = f"{max(time.time_ns(), last_run + 1):020d}-{uuid.uuid4().hex[:8]}"
        self.rows = {}
        for name in parts:
            with self._store.reading(name) as path:
                rows, _ = parse_rows(path.read_bytes(), self._store.path(name))
            self.rows |= {row.take: row for row in rows}

    def _write(self, lines: Sequence[str]) -> None:
        self._lines += lines
        name = f"{self._run}-{self._full_parts:06d}.jsonl"
        self._store.put(name, "".join(self._lines).encode())
        if len(self._lines) >= _ROWS_PER_PART:
            self._full_parts, self._lines = self._full_parts + 1, []


def parse_rows(data: bytes, name: str) -> tuple[list[Row], int]:
    """Return the rows of a manifest, and the length [bytes] of its complete lines.

    An incomplete last line is dropped, since the process that wrote it was killed.
    Raises InputError if another line is damaged.
    """
    rows: list[Row] = []
    length = 0
    for line in data.splitlines(keepends=True):
        end = length + len(line)
        try:
            row = Row.from_json(line.decode())
        except ValueError as error:
            if end == len(data):
                break
            wrong = f"line {len(rows) + 1} is damaged ({error})"
            hint = "delete it to clean its take again"
            raise InputError(f"{name}: {wrong}; {hint}") from None
        if line.endswith(b"\n"):
            rows.append(row)
            length = end
    return rows, length


def read_rows(folder: Path) -> list[Row]:
    """Return the last row of each take in a local manifest, or raise an InputError."""
    path = folder / _LINES
    try:
        rows, _ = parse_rows(path.read_bytes(), str(path))
    except FileNotFoundError:
        hint = "give a folder of clips from 'kinefilter batch'"
        raise InputError(f"{folder}: no {_LINES}; {hint}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    return list({row.take: row for row in rows}.values())


def write_csv(rows: Iterable[Row], store: Store) -> None:
    """Write ``manifest.csv``: a line per clip, or one for a take without clips.

    Raises InputError if it cannot be written.
    """
    columns = [f.name for f in fields(ClipRow) if f.name not in ("stamp", "sha256")]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("take", "status", *columns, "seconds", "error", "sensors"))

    def cell(value: object) -> str:
        if isinstance(value, tuple):
            return "; ".join(map(cell, value))
        if isinstance(value, dict):
            return ", ".join(f"{key} {cell(part)}" for key, part in value.items())
        if isinstance(value, float):
            return f"{value:.3f}" if abs(value) > 1e4 else f"{value:.6g}"
        return "" if value is None else str(value)

    for row in sorted(rows, key=lambda row: row.take):
        if row.status == "no take":
            continue
        clips = [[cell(getattr(clip, name)) for name in columns] for clip in row.clips]
        end = (f"{row.seconds:.3f}", row.error, cell(row.sensors))
        for cells in clips or [[""] * len(columns)]:
            table.writerow((row.take, row.status, *cells, *end))
    # Rows of older versions may contain names that are not UTF-8.
    store.put(_CSV, text.getvalue().encode(errors="backslashreplace"))
