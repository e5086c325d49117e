"""Cleaning one take of a batch again, with edits made since."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from kinefilter.characters import InputError
from kinefilter.pipeline.settings import Settings, fingerprint, overlaid, settings_in

from .manifest import Row, open_manifest, write_csv
from .plan import Job, find_sources, with_edits
from .sessions import Session
from .store import store_at
from .task import clean_file

_BATCH = "run 'kinefilter batch' again"


def find_takes(row: Row, folders: Sequence[Path]) -> list[Path]:
    """Return the files of a row's take, one per sensor, if a folder has all of them."""
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
            if path.exists() and store.sha256(clip.output) != clip.sha256:
                wrong = "was changed since the batch wrote it"
                hint = "move it away to clean its take again"
                raise InputError(f"{path}: {wrong}; {hint}")
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
        hint = "give the folder of the takes with --take"
        raise InputError(f"{row.take}: not found; {hint}")
    found = zip(find_sources([*map(str, takes)], str(out)), _names(row), strict=True)
    sources = tuple(replace(source, take=name) for source, name in found)
    hashes = (source.store.sha256(source.file.name) for source in sources)
    if row.sha256 != " ".join(hashes):
        wrong = "is not the take that the clip was made from, or was changed"
        raise InputError(f"{takes[0]}: {wrong}; {_BATCH}")
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
    sensors = tuple(str(sensor["sensor"]) for sensor in row.sensors)
    session = with_edits(Session(row.take, sources, sensors, settings))
    hashed = fingerprint(session.settings, suffix)
    return Job(*session, store_at(str(out)), row.output, hashed)


def _names(row: Row) -> list[str]:
    """Return the names of a row's files below the folder of takes."""
    return [str(sensor["source"]) for sensor in row.sensors] or [row.take]
