"""Records the raw frames as takes that ``clean`` reads, one file per body."""

import glob
import threading
from collections import deque
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path

from kinefilter.characters import InputError, Skeleton
from kinefilter.pipeline.formats.files import (
    append_whole,
    check_folder,
    make_folder,
    numbered,
)
from kinefilter.pipeline.formats.sheets import PART, take_header, take_rows

from .messages import SeenBody, as_arrays
from .tally import Event, Tally

_MAX_FILES = 64  # bodies in one recording
_MAX_WAITING = 10_000  # frames of a person by which the disk may fall behind
_MIN_FRAMES = 2  # of a take


@dataclass(eq=False)
class _Part:
    body: str  # the sender's name for the person
    path: Path
    file: FileIO
    last: float  # time stamp of the last frame [s]
    frames: int = 0  # written so far
    waiting: deque[tuple[float, SeenBody]] = field(default_factory=deque)


class Recorder:
    """Writes frames to part files, which get their final names at the end.

    Parts are called ``take.1.part.csv``. If the session is killed, a part is a take
    without its last second; its torn last row is not read. At the end, parts become
    ``take.csv`` or, for several bodies, ``take.1.csv``, ``take.2.csv`` and so on, in
    order of appearance. Raises InputError if files cannot be written there, or if a
    recording of that name exists.
    """

    def __init__(self, path: Path, skeleton: Skeleton, tally: Tally) -> None:
        check_folder(path)
        if path.suffix != ".csv":
            raise InputError(f"{path}: expected a name that ends in .csv")
        make_folder(path.parent)
        there = [path] if path.exists() else []
        there += sorted(path.parent.glob(f"{glob.escape(path.stem)}.*.csv"))
        if there:
            raise InputError(
                f"{there[0]}: exists already, and recordings are never overwritten; "
                "give another name, or move the file away"
            )
        self._path, self._skeleton, self._tally = path, skeleton, tally
        self._parts: list[_Part] = []
        self._writing = threading.Lock()
        self.failure: str | None = None  # why recording had to stop, if it had to

    def add(self, time: float, seen: SeenBody) -> None:
        """Keep a person's frame with the stamp ``time`` [s] for the next ``flush``."""
        part = self._part(time, seen)
        if part is None or len(part.waiting) >= _MAX_WAITING:
            self._tally.events[Event.UNRECORDED] += 1
            return
        part.last = time
        part.waiting.append((time, seen))

    def flush(self) -> None:
        """Write the frames since the last flush; threads that call it take turns."""
        with self._writing:
            for part in list(self._parts):
                rows = [part.waiting.popleft() for _ in range(len(part.waiting))]
                if rows and self.failure is None:
                    try:
                        append_whole(part.file, take_rows(*as_arrays(rows)).encode())
                        part.frames += len(rows)
                    except OSError as error:
                        self._fail(part.path, error)
                if self.failure is not None:
                    self._tally.events[Event.UNRECORDED] += len(rows)

    def finish(self) -> list[Path]:
        """Write the rest after any flush in progress, rename the files, return them."""
        self.flush()
        kept = [part for part in self._parts if part.frames >= _MIN_FRAMES]
        written = []
        for part in self._parts:
            try:
                part.file.close()
                if part in kept:
                    number = kept.index(part) + 1 if len(kept) > 1 else None
                    written.append(part.path.replace(numbered(self._path, number)))
                else:
                    part.path.unlink()
            except OSError as error:
                self._fail(part.path, error)
        self._parts.clear()
        return written

    def _part(self, time: float, seen: SeenBody) -> _Part | None:
        """Return a body's file, a new one if there is none or time goes backwards."""
        if self.failure is not None:
            return None
        own = (part for part in reversed(self._parts) if part.body == seen.id)
        if (part := next(own, None)) is not None and time >= part.last:
            return part
        if (number := len(self._parts) + 1) > _MAX_FILES:
            return None
        path = self._path.with_name(f"{self._path.stem}.{number}{PART}")
        try:
            part = _Part(seen.id, path, path.open("xb", buffering=0), time)
            self._parts.append(part)
            append_whole(part.file, take_header(self._skeleton).encode())
        except OSError as error:
            self._fail(path, error)
            return None
        return part

    def _fail(self, path: Path, error: OSError) -> None:
        wrong = f"recording stopped ({error.strerror or error})"
        self.failure = f"{path}: {wrong}; free some space and restart"
