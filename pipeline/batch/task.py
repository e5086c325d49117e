"""A take of a batch, from its file to its clips: what a worker does.

A worker keeps the correction methods that it has made, with their databases and
models, for the next take; each starts over with every take.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import PurePosixPath
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from kinefilter.characters import Clip, InputError
from kinefilter.pipeline.cleaner import Cleaner, CleanResult
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import Recording, write_clip
from kinefilter.pipeline.formats.plain import finite, printable
from kinefilter.pipeline.formats.recording import numbered, part_paths
from kinefilter.pipeline.settings import Settings, fingerprint, hash_of
from kinefilter.pipeline.workers import give_back_memory, given_up, one_thread

from .manifest import ClipRow, Row
from .plan import Job
from .sessions import Source

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged

_KEPT = 4  # correction methods in memory: two skeletons, of two folders at a time
_LONGEST = 1000  # characters of an error that a row keeps


def clean_file(job: Job) -> Row:
    """Clean a take and write its clips; errors are in the row."""
    start = perf_counter()
    known: dict[str, Any] = {"status": "done"}
    with one_thread():
        try:
            suffix = PurePosixPath(job.output).suffix
            _check_same(job.settings, suffix, job.fingerprint)
            read = [_read(source, job.settings) for source in job.sources]
            known["sha256"] = " ".join(sha256 for _, sha256 in read)
            if any(recording for recording, _ in read):
                known |= _write_clips([recording for recording, _ in read], job)
            else:
                known["status"] = "no take"
        except InputError as refused:
            known["error"] = str(refused)
        except Exception as unforeseen:  # the other takes are still to be cleaned
            wrong = f"cannot be cleaned ({type(unforeseen).__name__}: {unforeseen})"
            known["error"] = wrong
    read = []
    give_back_memory()
    if known.get("error"):
        known |= {"status": "failed", "error": printable(known["error"])[:_LONGEST]}
    return job.row(**known, seconds=perf_counter() - start)


def _read(source: Source, settings: Settings) -> tuple[Recording | None, str]:
    """Return a take's content, or None if the file is none, and the file's hash."""
    with source.store.reading(source.file.name) as path:
        sha256 = hash_of(path)
        try:
            if not source.is_take(path, settings.format):
                return None, sha256
            recording = settings.read(path)
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


def _write_clips(read: Sequence[Recording | None], job: Job) -> dict[str, Any]:
    """Clean the people asked for; return what was written, and what went wrong."""
    recordings = [recording for recording in read if recording is not None]
    bodies = recordings[0].numbers(job.settings.body)
    if len(recordings) > 1 and job.settings.body == "all":
        raise InputError("--body all is for one sensor; choose a person of its take")
    names = [n for n, take in zip(job.sensors, read, strict=False) if take is not None]
    told = (*_told_of_sensors(read, job), *recordings[0].notes)
    known: dict[str, Any] = {"clips": ()}
    errors = []
    for body in bodies:
        path = numbered(PurePosixPath(job.output), body if len(bodies) > 1 else None)
        try:
            result, merged = _cleaned(recordings, body, job)
            notes = (*told, *(merged.told() if merged else ()), *result.notes)
            told_of = replace(result, notes=notes)
            paths = part_paths(path, len(result.clips))
            known["clips"] += tuple(
                _written(told_of, clip, str(path), body, job)
                for path, clip in zip(paths, result.clips, strict=True)
            )
            if merged:
                figures = zip(names, merged.figures()["sensors"], strict=True)
                known["sensors"] = tuple({"sensor": n} | row for n, row in figures)
        except InputError as error:
            errors.append(str(error))
    return known | {"error": "; ".join(errors)}


def _told_of_sensors(read: Sequence[Recording | None], job: Job) -> Iterator[str]:
    """Yield which sensors have no take in a session."""
    for recording, source in zip(read, job.sources, strict=True):
        if recording is None:
            yield f"{source.take} is no take: cleaned without it"
    absent = [name for name in job.settings.sensors if name not in job.sensors]
    if absent:
        yield f"there is no take of {' and '.join(absent)}: cleaned without"
    elif len(job.sensors) == 1:
        yield "there is no take of another sensor: cleaned by itself"


@lru_cache(maxsize=_KEPT)
def _cleaner(config: CleanConfig, _fingerprint: str) -> Cleaner:
    """Return a cleaner; the fingerprint tells changed files apart."""
    return Cleaner(config)


def _cleaned(
    recordings: Sequence[Recording], body: int, job: Job
) -> tuple[CleanResult, Merged | None]:
    """Clean a person of a take or session; return what was merged, too."""
    settings = job.settings
    if len(recordings) == 1:
        cleaner = _cleaner(settings.config, job.fingerprint)
        take = recordings[0].take(body)
        return cleaner.clean(take, progress=_while_awaited), None
    from kinefilter.pipeline.merge import clean_session, read_calibration

    if len(set(job.sensors)) < len(job.sensors):
        raise InputError(
            f"{', '.join(source.take for source in job.sources)}: are not each of "
            "another sensor by --sessions; narrow the pattern"
        )
    return clean_session(
        recordings,
        settings.config,
        body=body,
        calibration=read_calibration(settings.calibration),
        progress=_while_awaited,
    )


def _written(
    result: CleanResult, clip: Clip, name: str, body: int, job: Job
) -> ClipRow:
    """Write a clip of a person, and return its main figures."""
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
        unexplained_force_body_weights=finite(last.unexplained_force),
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
