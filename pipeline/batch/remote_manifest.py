"""A manifest where no file can be added to: parts, each of at most a thousand lines.

The last part is written anew with every row until it is full. Every run has parts of
its own, so that two which should not run at once at least lose nothing.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Sequence

from .places import store_at
from .row import Row, parse_rows
from .store import Store

PARTS = "manifest"
"""Name of the folder of parts."""
_FULL = 1000  # rows of a part: under a megabyte


class PartedManifest:
    """The lines of an output folder in a store."""

    def __init__(self, store: Store) -> None:
        """Read what earlier runs did."""
        self._store = store_at(f"{store.root}/{PARTS}")
        self._lines: list[str] = []
        self._full = 0
        # Parts are read in the order of their names: a later run's rows count.
        self._run = f"{time.time_ns():020d}-{uuid.uuid4().hex[:8]}"
        self.rows: dict[str, Row] = {}
        for name in sorted(file.name for file in self._store.files()):
            self.rows |= {row.take: row for row in self._part(name)}

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows; they are in the store when this returns."""
        self._lines += [row.as_json() + "\n" for row in rows]
        name = f"{self._run}-{self._full:06d}.jsonl"
        self._store.put(name, "".join(self._lines).encode())
        self.rows.update((row.take, row) for row in rows)
        if len(self._lines) >= _FULL:
            self._full, self._lines = self._full + 1, []

    def _part(self, name: str) -> list[Row]:
        with self._store.reading(name) as path:
            return parse_rows(path.read_bytes(), self._store.path(name))[0]
