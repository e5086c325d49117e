"""What became of each take: a line of the manifest, never changed once written.

The last line of a take is the one that counts. A run that is killed loses at most the
lines that it was writing; the next run drops what is torn and cleans those takes again.
In a folder the lines are in one file. In a store, where nothing can be appended, they
are in parts of at most a thousand lines; the last part is rewritten with every row
until it is full. Every run has parts of its own, so that two runs at once, which should
not happen, at least lose nothing.
"""

from __future__ import annotations

import csv
import io
import json
import os
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock, Timeout

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.plain import finite

from .store import Store, store_at

_LINES, _PARTS = "manifest.jsonl", "manifest"  # a file, at a URL a folder of files
_CSV = "manifest.csv"
_LOCK = "manifest.lock"
_PATIENCE = 0.5  # s: a file system without locks may first have to clear a dead one's
_LISTS = ("notes", "damage")
_FULL = 1000  # rows of a part: under a megabyte

Status = Literal["done", "failed", "no take"]
"""What became of a file; of a take that failed at least one clip is missing."""


@dataclass(frozen=True, slots=True)
class ClipRow:
    """A clip of one person, and its main figures; None where nothing was measured."""

    output: str  # path below the output folder, split by /
    stamp: str  # size and time of the file when it was written
    sha256: str
    body: int  # which person of the take, counted from 1
    frames: int
    motion_seconds: float
    jitter_raw: float | None  # of the take [m/s^3], see Quality
    jitter: float | None  # of the clip [m/s^3]
    skate_mm_per_frame: float | None  # how far feet slide on the floor, mean
    external_force_body_weights: (
        float | None
    )  # that only the pulls of physics explain, mean
    share_outside_database: float | None  # of frames; the database lacks their posture
    failures: int  # of the tracker: gross ones, and displaced limbs
    notes: tuple[str, ...]  # what the user should know
    damage: tuple[str, ...] = ()  # of the take: what and when, a sentence each
    unexplained_force_body_weights: float | None = None  # no contact gives it, mean


@dataclass(frozen=True, slots=True)
class Row:
    """A file that was looked at."""

    take: str  # its name, see Source
    status: Status
    output: str  # the clip's path in the output folder, without a person's number
    stamp: str  # size and time of the take's file when it was read
    sha256: str = ""  # of the take's file; empty if it could not be read
    settings: str = ""  # their fingerprint
    seconds: float = 0.0  # that it took
    clips: tuple[ClipRow, ...] = ()  # one per person
    error: str = ""  # why a clip is missing
    sensors: tuple[dict[str, Any], ...] = ()
    """Of a session each sensor's take, and when and where it is (``Merged.figures``);
    one, if it has no partner."""

    def as_json(self) -> str:
        """Return the row as a line, without a line end."""
        return json.dumps(finite(asdict(self)), allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Return the row of a line; raises ValueError if it is damaged or too old."""
        values = json.loads(line)
        try:
            clips = tuple(
                # Rows of older versions lack the damage, and the sensors.
                ClipRow(**clip | {k: tuple(clip.get(k, ())) for k in _LISTS})
                for clip in values.pop("clips")
            )
            values["sensors"] = tuple(values.get("sensors", ()))
            return cls(**values, clips=clips)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"not a row of a manifest: {error}") from None


def _with_line(row: Row) -> tuple[Row, str]:
    """Return a row and its line, or those of a failed take if it has none."""
    try:
        return row, row.as_json()
    except (TypeError, ValueError) as error:
        wrong = f"its figures cannot be written ({error})"
        failed = Row(row.take, "failed", row.output, row.stamp, error=wrong)
        return failed, failed.as_json()


class Manifest:
    """The rows of one output folder: lines of a file, which this process alone writes.

    ``rows`` has the last of each take.
    """

    def __init__(self, file: io.FileIO, path: Path) -> None:
        rows, self._length = parse_rows(file.readall(), str(path))
        file.truncate(self._length)
        self._file, self._path = file, path
        self.rows = {row.take: row for row in rows}

    def append(self, rows: Iterable[Row]) -> list[Row]:
        """Write rows that are not there yet to the disk, and return them.

        One that holds what JSON does not becomes that of a failed take. Raises
        InputError if they cannot be written.
        """
        new = [_with_line(row) for row in rows if row is not self.rows.get(row.take)]
        if new:
            self._write([line + "\n" for _, line in new])
            self.rows.update((row.take, row) for row, _ in new)
        return [row for row, _ in new]

    def _write(self, lines: Sequence[str]) -> None:
        data = memoryview("".join(lines).encode())
        try:
            self._file.seek(self._length)
            while data:  # the system may take a part of it at a time
                data = data[self._file.write(data) or 0 :]
            os.fsync(self._file.fileno())
        except OSError as error:
            self._file.truncate(self._length)  # needs no room, unlike half a line
            raise InputError(
                f"{self._path}: cannot be written ({error.strerror}); make room, and "
                "the same command goes on"
            ) from error
        self._length = self._file.tell()


@contextmanager
def open_manifest(store: Store) -> Iterator[Manifest]:
    """Yield the manifest of an output folder, which is made if it is missing.

    Raises InputError if another run writes there, nothing can be written, or a line
    that is not the last is damaged.
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
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); write elsewhere"
        ) from error
    with file:
        try:
            # The system releases the lock when the process ends, however it ends.
            lock = FileLock(path.with_name(_LOCK)).acquire(_PATIENCE)
        except Timeout:
            wrong = "another run writes there; wait for it, or write elsewhere"
            raise InputError(f"{store.root}: {wrong}") from None
        with lock:
            try:
                yield Manifest(file, path)
            finally:
                with suppress(OSError):  # Windows removes no file that is open
                    path.with_name(_LOCK).unlink()


class _InParts(Manifest):
    """Lines of several files in a store."""

    def __init__(self, store: Store) -> None:
        self._store = store_at(f"{store.root}/{_PARTS}")
        self._lines: list[str] = []
        self._full = 0
        # Parts are read in the order of their names: a later run's rows count, also
        # where the clock has gone back.
        parts = sorted(file.name for file in self._store.files())
        before = int(parts[-1].partition("-")[0]) if parts else 0
        self._run = f"{max(time.time_ns(), before + 1):020d}-{uuid.uuid4().hex[:8]}"
        self.rows = {}
        for name in parts:
            with self._store.reading(name) as path:
                rows, _ = parse_rows(path.read_bytes(), self._store.path(name))
            self.rows |= {row.take: row for row in rows}

    def _write(self, lines: Sequence[str]) -> None:
        self._lines += lines
        name = f"{self._run}-{self._full:06d}.jsonl"
        self._store.put(name, "".join(self._lines).encode())
        if len(self._lines) >= _FULL:
            self._full, self._lines = self._full + 1, []


def parse_rows(data: bytes, name: str) -> tuple[list[Row], int]:
    """Return the rows of a manifest, and how many bytes are whole lines.

    A last line that is torn is dropped: the process that wrote it was killed. Raises
    InputError if another line is damaged.
    """
    rows: list[Row] = []
    whole = 0
    for line in data.splitlines(keepends=True):
        end = whole + len(line)
        try:
            row = Row.from_json(line.decode())
        except ValueError as error:
            if end == len(data):
                break
            raise InputError(
                f"{name}: line {len(rows) + 1} is damaged ({error}); delete it, and "
                "its take is cleaned again"
            ) from None
        if line.endswith(b"\n"):
            rows.append(row)
            whole = end
    return rows, whole


def write_csv(rows: Iterable[Row], store: Store) -> None:
    """Write the table for people: a line a clip, and a line a take that has none.

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
            return ", ".join(f"{key} {cell(one)}" for key, one in value.items())
        if isinstance(value, float):
            return f"{value:.3f}" if abs(value) > 1e4 else f"{value:.6g}"
        return "" if value is None else str(value)

    for row in sorted(rows, key=lambda row: row.take):
        if row.status == "no take":
            continue
        clips = [[cell(getattr(clip, name)) for name in columns] for clip in row.clips]
        for cells in clips or [[""] * len(columns)]:
            seconds = f"{row.seconds:.3f}"
            ends = (seconds, row.error, cell(row.sensors))
            table.writerow((row.take, row.status, *cells, *ends))
    # Rows of older versions may hold names that are not UTF-8.
    store.put(_CSV, text.getvalue().encode(errors="backslashreplace"))
