"""A take of a batch, from its file to its clips: what a worker does.

A worker keeps the correction methods that it has made, with their databases and
models, for the next take; each starts over with every take.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import PurePosixPath
from time import perf_counter

import numpy as np

from kinefilter.characters import Clip, InputError, Take
from kinefilter.pipeline.cleaner import Cleaner, CleanResult
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import Recording, write_clip
from kinefilter.pipeline.formats.plain import finite, printable
from kinefilter.pipeline.formats.recording import numbered, part_paths
from kinefilter.pipeline.formats.takes import read_recording
from kinefilter.pipeline.settings import Settings, fingerprint, hash_of
from kinefilter.pipeline.workers import give_back_memory, given_up, one_thread

from .manifest import ClipRow, Row, Status
from .plan import Job

_KEPT = 4  # correction methods in memory: two skeletons, of two folders at a time
_LONGEST = 1000  # characters of an error that a row keeps


def clean_file(job: Job) -> Row:
    """Clean a take and write its clips; errors are in the row."""
    start = perf_counter()
    status: Status = "done"
    sha256, clips, error = "", tuple[ClipRow, ...](), ""
    with one_thread():
        try:
            suffix = PurePosixPath(job.output).suffix
            _check_same(job.settings, suffix, job.fingerprint)
            recording, sha256 = _read(job)
            if recording is None:
                status = "no take"
            else:
                clips, error = _write_clips(recording, job)
        except InputError as refused:
            error = str(refused)
        except Exception as unforeseen:  # the other takes are still to be cleaned
            error = f"cannot be cleaned ({type(unforeseen).__name__}: {unforeseen})"
    recording = None
    give_back_memory()
    status, error = "failed" if error else status, printable(error)[:_LONGEST]
    seconds = perf_counter() - start
    return job.row(status, sha256=sha256, seconds=seconds, clips=clips, error=error)


def _read(job: Job) -> tuple[Recording | None, str]:
    """Return a take's content, or None if the file is none, and the file's hash."""
    source = job.source
    with source.store.reading(source.file.name) as path:
        sha256 = hash_of(path)
        try:
            if not source.is_take(path, job.settings.format):
                return None, sha256
            recording = read_recording(path, format=job.settings.format)
        except InputError as error:
            # The user does not know the name of a temporary copy.
            where = source.store.path(source.file.name)
            raise InputError(str(error).replace(str(path), where)) from None
    takes = [
        # The clip must not depend on where the folder, or a copy of the file, is.
        replace(take, source=take.source.replace(str(path), source.take))
        for take in recording.takes
    ]
    return replace(recording, takes=tuple(takes)), sha256


def _write_clips(recording: Recording, job: Job) -> tuple[tuple[ClipRow, ...], str]:
    """Clean the people asked for; return what was written, and what went wrong."""
    bodies = recording.numbers(job.settings.body)
    clips, errors = [], []
    for body in bodies:
        path = numbered(PurePosixPath(job.output), body if len(bodies) > 1 else None)
        try:
            rows = _write_clip(recording.take(body), path, body, job)
            clips += [replace(r, notes=(*recording.notes, *r.notes)) for r in rows]
        except InputError as error:
            errors.append(str(error))
    return tuple(clips), "; ".join(errors)


@lru_cache(maxsize=_KEPT)
def _cleaner(config: CleanConfig, _fingerprint: str) -> Cleaner:
    """Return a cleaner; the fingerprint tells changed files apart."""
    return Cleaner(config)


def _write_clip(
    take: Take, output: PurePosixPath, body: int, job: Job
) -> list[ClipRow]:
    """Clean a take, write its clips, and return its main figures for each."""
    cleaner = _cleaner(job.settings.config, job.fingerprint)
    result = cleaner.clean(take, progress=_while_awaited)
    paths = part_paths(output, len(result.clips))
    return [
        _written(result, clip, str(path), body, job)
        for path, clip in zip(paths, result.clips, strict=True)
    ]


def _written(
    result: CleanResult, clip: Clip, name: str, body: int, job: Job
) -> ClipRow:
    with job.store.writing(name) as path:
        write_clip(clip, path, job.settings.export)
        sha256 = hash_of(path)
    file = job.store.find(name)
    if file is None:
        raise InputError(f"{job.store.path(name)}: was removed while it was written")
    trace, last = result.trace, [*result.stages.values()][-1]
    force = np.nan if trace is None else float(trace.external_force.mean())
    return ClipRow(
        output=name,
        stamp=file.stamp,
        sha256=sha256,
        body=body,
        frames=len(clip),
        motion_seconds=float(clip.time[-1] - clip.time[0]),
        jitter_raw=finite(result.stages["raw"].jitter),
        jitter=finite(last.jitter),
        skate_mm_per_frame=finite(last.skate_mm_per_frame),
        external_force_body_weights=finite(force),
        share_outside_database=finite(result.share_outside),
        failures=len(result.failures),
        notes=result.notes,
        damage=result.damage,
    )


@lru_cache(maxsize=_KEPT)
def _check_same(settings: Settings, suffix: str, planned: str) -> None:
    """Raise an InputError if this worker's settings differ from those of the plan."""
    if fingerprint(settings, suffix) != planned:
        raise InputError(
            "this worker has another kinefilter, model or database than the machine "
            "that gave it the take; install and copy the same"
        )


def _while_awaited(_stage: str, count: int) -> Iterator[int]:
    """Yield the steps of a stage as long as somebody waits for it."""
    for step in range(count):
        if given_up():
            sys.exit()  # a process of its own, which ends with unfinished files gone
        yield step
