"""The work of one worker of a batch, from a take's file to its clips; also again."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from time import perf_counter
from typing import Any

import numpy as np

from kinefilter.characters import Clip, InputError
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import Recording, write_clip
from kinefilter.pipeline.formats.export import timing_notes
from kinefilter.pipeline.formats.files import numbered, part_paths
from kinefilter.pipeline.formats.plain import finite, printable
from kinefilter.pipeline.settings import (
    Settings,
    fingerprint,
    hash_of,
    overlaid,
    settings_in,
)
from kinefilter.pipeline.workers import give_back_memory, given_up, one_thread

from .manifest import ClipRow, Row, open_manifest, write_csv
from .plan import Job, with_edits
from .sessions import Session, Source
from .store import canonical, store_at

_KEPT = 4  # cleaners in memory: for two skeletons in each of two folders
_MAX_ERROR = 1000  # characters of an error in a row


def clean_file(job: Job) -> Row:
    """Clean a take and write its clips; errors are reported in the row."""
    start = perf_counter()
    row: dict[str, Any] = {"status": "done"}
    with one_thread():
        try:
            if job.error:
                raise InputError(job.error)
            _check_same(job.settings, PurePosixPath(job.output).suffix, job.fingerprint)
            read = [_read(source, job.settings) for source in job.sources]
            row["sha256"] = " ".join(sha256 for _, sha256 in read)
            if any(recording for recording, _ in read):
                row |= _write_clips([recording for recording, _ in read], job)
            else:
                row["status"] = "no take"
        except InputError as error:
            row["error"] = str(error)
        except Exception as error:  # must not end the batch
            row["error"] = f"cannot be cleaned ({type(error).__name__}: {error})"
    read = []  # free the memory
    give_back_memory()
    if row.get("error"):
        row |= {"status": "failed", "error": printable(row["error"])[:_MAX_ERROR]}
    return job.row(**row, seconds=perf_counter() - start)


def _read(source: Source, settings: Settings) -> tuple[Recording | None, str]:
    """Return a file's recording, or None if it is not a take, and its hash."""
    with source.store.reading(source.file.name) as path:
        sha256 = hash_of(path)
        try:
            if not source.is_take(path, settings.format):
                return None, sha256
            recording = settings.read(path)
        except InputError as error:
            # Name the user's file, not a temporary copy.
            where = source.store.path(source.file.name)
            raise InputError(str(error).replace(str(path), where)) from None
    takes = [
        # The clip must not depend on the location of the folder or of a copy.
        replace(take, source=take.source.replace(str(path), source.take))
        for take in recording.takes
    ]
    return replace(recording, takes=tuple(takes)), sha256


def why_no_take(job: Job) -> str:
    """Return why the first file of a job is no take, or what to try."""
    source = job.sources[0]
    where = source.store.path(source.file.name)
    with source.store.reading(source.file.name) as path:
        try:
            job.settings.read(path)
        except InputError as error:
            return str(error).replace(str(path), where)
    return f"{where}: does not begin like a take; to clean it nevertheless, name it"


def _write_clips(read: Sequence[Recording | None], job: Job) -> dict[str, Any]:
    """Clean the chosen people, and return values of the row, with any errors."""
    recordings = [recording for recording in read if recording is not None]
    bodies = job.settings.people(recordings)
    if len(recordings) > 1 and len(set(job.sensors)) < len(job.sensors):
        raise InputError(
            f"{', '.join(source.take for source in job.sources)}: several are by the "
            "same sensor according to --sessions; use a narrower pattern"
        )
    cleaner = _cleaner(job.settings.config, job.fingerprint)
    names = [n for n, take in zip(job.sensors, read, strict=False) if take is not None]
    take_notes = (*_missing_sensors(read, job), *recordings[0].notes)
    take_notes += (*job.settings.left_out(recordings),)
    row: dict[str, Any] = {"clips": ()}
    errors = []
    cleaned = job.settings.clean(recordings, bodies, cleaner, _while_awaited)
    for body, result, merged in cleaned:
        path = numbered(PurePosixPath(job.output), body if len(bodies) > 1 else None)
        try:
            if isinstance(result, InputError):
                raise result
            fused = merged.all_notes() if merged else ()
            timing = timing_notes(job.settings.export, path.suffix, result.clips)
            notes = (*take_notes, *fused, *result.notes, *timing)
            result = replace(result, notes=notes)
            each = zip(part_paths(path, len(result.clips)), result.clips, strict=True)
            row["clips"] += tuple(_write(result, c, str(p), body, job) for p, c in each)
            if merged:
                figures = zip(names, merged.figures()["sensors"], strict=True)
                row["sensors"] = tuple({"sensor": n} | values for n, values in figures)
        except InputError as error:
            errors.append(str(error))
    return row | {"error": "; ".join(errors)}


def _missing_sensors(read: Sequence[Recording | None], job: Job) -> Iterator[str]:
    """Yield a note for each sensor without a take in a session."""
    for recording, source in zip(read, job.sources, strict=True):
        if recording is None:
            yield f"{source.take} is not a take; cleaned without it"
    absent = [name for name in job.settings.sensors if name not in job.sensors]
    if absent:
        yield f"no take of {' and '.join(absent)}; cleaned without"
    elif len(job.sensors) == 1:
        yield "no take of another sensor; cleaned alone"


@lru_cache(maxsize=_KEPT)
def _cleaner(config: CleanConfig, _fingerprint: str) -> Cleaner:
    """Return a cached cleaner; the fingerprint changes with the contents of files."""
    return Cleaner(config)


def _write(result: CleanResult, clip: Clip, name: str, body: int, job: Job) -> ClipRow:
    with job.store.writing(name) as path:
        write_clip(clip, path, job.settings.export)
        sha256 = hash_of(path)
    file = job.store.find(name)
    if file is None:
        raise InputError(f"{job.store.path(name)}: was removed while being written")
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
    """Raise an InputError if settings here differ from those planned."""
    if fingerprint(settings, suffix) != planned:
        raise InputError(
            "this worker has another kinefilter, model or database than the machine "
            "that started the batch; install and copy the same ones"
        )


def _while_awaited(_stage: str, count: int) -> Iterator[int]:
    """Yield the steps of a stage until the parent process stops waiting."""
    for step in range(count):
        if given_up():
            sys.exit()  # ends this process, removing unfinished files
        yield step


_BATCH = "run 'kinefilter batch' again"


def find_takes(row: Row, folders: Sequence[Path]) -> list[Path]:
    """Return the files of a row's take, one per sensor; empty if not all are found.

    They are looked for below each of the folders of takes.
    """
    for folder in folders:
        paths = [folder / name for name in _names(row)]
        if all(path.is_file() for path in paths):
            return paths
    return []


def clean_again(row: Row, out: Path, takes: Sequence[Path]) -> Row:
    """Clean a row's take as the batch in ``out`` did, with the edits beside it.

    ``takes`` are its files (``find_takes``). The clips, the row and the table are
    replaced as a batch would do it. Raises InputError, and changes nothing, if the
    take, the clips or the options are not those of the row, the edits do not fit, or
    another run is writing there.
    """
    store = store_at(str(out))
    job = _job(row, out, takes)
    with open_manifest(store) as manifest:
        for clip in row.clips:
            path = out / clip.output
            if path.exists() and hash_of(path) != clip.sha256:
                raise InputError(
                    f"{path}: was changed since the batch wrote it; move it away to "
                    "clean its take again"
                )
        done = clean_file(job)
        if done.status != "done":
            raise InputError(f"{row.take}: {done.error or 'is not a take'}")
        manifest.append([done])
        write_csv(manifest.rows.values(), store)
    return done


def _job(row: Row, out: Path, takes: Sequence[Path]) -> Job:
    """Return the job that made a row, now with the edits beside the take."""
    for name in (row.output, *(clip.output for clip in row.clips)):
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise InputError(f"{name}: is not in {out}; {_BATCH}")
    if not takes:
        raise InputError(
            f"{row.take}: not found; give the folder of the takes with --take"
        )
    if row.sha256 != " ".join(map(hash_of, takes)):
        raise InputError(
            f"{takes[0]}: is not the take that the clip was made from, or was changed; "
            f"{_BATCH}"
        )
    options = settings_in(row.options, f"{out}: options of {row.take}", Path.cwd())
    settings, suffix = overlaid(Settings(), options), Path(row.output).suffix
    if settings.config.edits is not None:
        why = f"its batch has --edits {settings.config.edits}"
        raise InputError(f"{row.take}: {why}; change that file, and {_BATCH}")
    if settings.body == "all":
        raise InputError(f"{row.take}: edits are for one person, not for --body all")
    if fingerprint(settings, suffix) != row.settings.partition("-")[0]:
        raise InputError(
            f"{row.take}: its batch had another version of kinefilter, options that it "
            f"did not record, or files that changed since; {_BATCH}"
        )
    sources = [
        Source(name, store_at(str(path.parent)), canonical(str(path)), file, named=True)
        for name, path in zip(_names(row), takes, strict=True)
        if (file := store_at(str(path.parent)).find(path.name))
    ]
    sensors = tuple(str(sensor["sensor"]) for sensor in row.sensors)
    session = with_edits(Session(row.take, tuple(sources), sensors, settings))
    hashed = fingerprint(session.settings, suffix)
    return Job(*session, store_at(str(out)), row.output, hashed)


def _names(row: Row) -> list[str]:
    """Return the names of a row's files below the folder of takes."""
    return [str(sensor["source"]) for sensor in row.sensors] or [row.take]
