"""A take of a batch, from its file to its clip: what a worker does.

A worker keeps the correction methods that it has made, with their databases and
models, for the next take; each is told to forget the one before.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import PurePosixPath
from time import perf_counter

from kinefilter.characters import InputError
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import Recording, write_clip
from kinefilter.pipeline.formats.recording import numbered
from kinefilter.pipeline.formats.takes import read_recording
from kinefilter.pipeline.settings import Settings, fingerprint, hash_of
from kinefilter.pipeline.workers import give_back_memory, given_up, one_thread

from .plan import Job
from .row import ClipRow, Row, clip_row
from .sources import is_take

_KEPT = 4  # correction methods in memory: two skeletons, of two folders at a time
_LONGEST = 1000  # characters of an error that a row keeps

# Correction methods hold a take's state; a cluster may run tasks on threads.
_one_at_a_time = threading.Lock()


class _GivenUpError(Exception):
    """Nobody waits for the take any more."""


def clean_file(job: Job) -> Row:
    """Clean a take and write its clips; what goes wrong is in the row."""
    start = perf_counter()
    sha256, clips, error = "", tuple[ClipRow, ...](), ""
    with _one_at_a_time, one_thread():
        try:
            suffix = PurePosixPath(job.output).suffix
            _check_same(job.settings, suffix, job.fingerprint)
            recording, sha256 = _read(job)
            if recording is not None:
                clips, error = _cleaned(recording, job)
        except _GivenUpError:
            raise
        except InputError as refused:
            recording, error = None, str(refused)
        except Exception as unforeseen:  # the other takes are to be cleaned
            recording = None
            error = f"cannot be cleaned ({type(unforeseen).__name__}: {unforeseen})"
    other = recording is None and not error
    del recording
    give_back_memory()
    return Row(
        take=job.source.take,
        status="failed" if error else "no take" if other else "done",
        output=job.output,
        stamp=job.source.file.stamp,
        sha256=sha256,
        settings=job.fingerprint,
        seconds=perf_counter() - start,
        clips=clips,
        error=error[:_LONGEST],
    )


def _read(job: Job) -> tuple[Recording | None, str]:
    """Return what a file holds, nothing if it is no take, and the hash of its bytes."""
    source = job.source
    with source.store.reading(source.file.name) as path:
        sha256 = hash_of(path)
        try:
            if not is_take(source, path, job.settings.format):
                return None, sha256
            recording = read_recording(path, format=job.settings.format)
        except InputError as error:
            # A copy's name means nothing to anybody.
            where = source.store.path(source.file.name)
            raise InputError(str(error).replace(str(path), where)) from None
    takes = [
        # The clip must not depend on where the folder lies, or a copy of the file.
        replace(take, source=take.source.replace(str(path), source.take))
        for take in recording.takes
    ]
    return replace(recording, takes=tuple(takes)), sha256


def _cleaned(recording: Recording, job: Job) -> tuple[tuple[ClipRow, ...], str]:
    """Clean who was asked for; return what was written, and what went wrong."""
    bodies = recording.numbers(job.settings.body)
    clips, errors = [], []
    for body in bodies:
        path = numbered(PurePosixPath(job.output), body if len(bodies) > 1 else None)
        try:
            clips.append(_cleaned_body(recording, body, str(path), job))
        except InputError as error:
            errors.append(str(error))
    return tuple(clips), "; ".join(errors)


def _cleaned_body(recording: Recording, body: int, name: str, job: Job) -> ClipRow:
    """Clean one person, write the clip, and return its figures."""
    take, settings = recording.take(body), job.settings
    cleaner = _cleaner(settings.config, job.fingerprint)
    result = cleaner.clean(take, progress=_watched)
    with job.store.writing(name) as path:
        write_clip(result.clip, path, settings.export)
        sha256 = hash_of(path)
    file = job.store.found(name)
    if file is None:
        raise InputError(f"{job.store.path(name)}: was removed while it was written")
    return clip_row(result, name, file.stamp, sha256, body)


@lru_cache(maxsize=_KEPT)
def _cleaner(config: CleanConfig, fingerprint: str) -> Cleaner:
    """Return a cleaner; the fingerprint tells changed files apart."""
    del fingerprint
    return Cleaner(config)


@lru_cache(maxsize=_KEPT)
def _check_same(settings: Settings, suffix: str, fingerprint_there: str) -> None:
    """Raise an InputError if this worker would do another thing than was planned."""
    if fingerprint(settings, suffix) != fingerprint_there:
        raise InputError(
            "this worker has another kinefilter, model or database than the machine "
            "that gave it the take; install and copy the same"
        )


def _watched(stage: str, count: int) -> Iterator[int]:
    """Yield the steps of a stage as long as anybody waits for it."""
    del stage
    for step in range(count):
        if given_up():
            raise _GivenUpError
        yield step
