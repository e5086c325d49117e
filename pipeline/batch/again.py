"""Cleaning one take of a batch again, with edits made since."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from kinefilter.characters import InputError
from kinefilter.pipeline.settings import (
    Settings,
    fingerprint,
    hash_of,
    overlaid,
    settings_in,
)

from .manifest import Row, open_manifest, write_csv
from .plan import Job, with_edits
from .sessions import Session, Source
from .store import canonical, store_at
from .task import clean_file

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
