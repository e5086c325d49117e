"""What a run has done: a line a take, never changed once it is there.

The last line of a take is the one that counts. A run that is killed loses at most the
lines that it was writing; the next one drops what is torn and does those takes again.
"""

from __future__ import annotations

import csv
import fcntl
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Protocol

from kinefilter.characters import InputError

from .local import LocalStore
from .remote_manifest import PartedManifest
from .row import ClipRow, Row, parse_rows
from .store import Store

LINES = "manifest.jsonl"
"""Name of the file of lines, which a resumed run reads; a URL has ``PARTS``."""
CSV = "manifest.csv"
"""Name of the table for people, written when a run ends."""

_CLIP_COLUMNS = tuple(
    field.name for field in fields(ClipRow) if field.name not in ("stamp", "sha256")
)


class Manifest(Protocol):
    """The lines of one output folder."""

    rows: dict[str, Row]
    """The last row of each take."""

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows; they are on the disk when this returns."""


@contextmanager
def open_manifest(store: Store) -> Iterator[Manifest]:
    """Yield the manifest of an output folder, which is made if it is missing.

    Raises:
        InputError: Another run writes there, nothing can be written, or a line that is
            not the last is damaged.
    """
    if isinstance(store, LocalStore):
        with _opened(store) as file:
            yield _Appended(file, store.path(LINES))
    else:
        yield PartedManifest(store)


@contextmanager
def _opened(store: LocalStore) -> Iterator[io.FileIO]:
    """Yield the file of lines, which this process alone writes."""
    path = Path(store.path(LINES))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = io.FileIO(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); write elsewhere"
        ) from error
    with file:
        try:
            # The system lets go of it when the process ends, however it does.
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{store.root}: another run writes there; wait for it, or write "
                "elsewhere"
            ) from None
        yield file


class _Appended:
    """Lines at the end of a local file."""

    def __init__(self, file: io.FileIO, path: str) -> None:
        data = file.readall()
        lines, self._length = parse_rows(data, path)
        file.truncate(self._length)
        self._file, self._path = file, path
        self.rows = {row.take: row for row in lines}

    def append(self, rows: Sequence[Row]) -> None:
        data = memoryview("".join(row.as_json() + "\n" for row in rows).encode())
        try:
            self._file.seek(self._length)
            _write_all(self._file, data)
            os.fsync(self._file.fileno())
        except OSError as error:
            self._file.truncate(self._length)  # takes no room, unlike half a line
            raise InputError(
                f"{self._path}: cannot be written ({error.strerror}); make room, and "
                "the same command goes on"
            ) from error
        self._length = self._file.tell()
        self.rows.update((row.take, row) for row in rows)


def _write_all(file: io.FileIO, data: memoryview) -> None:
    """Write bytes, however many of them the system takes at a time."""
    while data:
        data = data[file.write(data) or 0 :]


def write_csv(rows: Iterable[Row], store: Store) -> None:
    """Write the table for people: a line a clip, and a line a take that has none.

    Raises:
        InputError: It cannot be written.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("take", "status", *_CLIP_COLUMNS, "seconds", "error"))
    for row in sorted(rows, key=lambda row: row.take):
        if row.status == "no take":
            continue
        clips = [_cells(clip) for clip in row.clips] or [[""] * len(_CLIP_COLUMNS)]
        for cells in clips:
            taken = f"{row.seconds:.3f}"
            table.writerow((row.take, row.status, *cells, taken, row.error))
    store.put(CSV, text.getvalue().encode())


def _cells(clip: ClipRow) -> list[str]:
    values = (getattr(clip, column) for column in _CLIP_COLUMNS)
    return [_cell(value) for value in values]


def _cell(value: object) -> str:
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)
