"""What there is to do: a job for each take, with the settings of its folder."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from kinefilter.characters import InputError
from kinefilter.pipeline.config_files import (
    FOLDER_FILE,
    SettingsFile,
    overlaid,
    parse_settings,
)
from kinefilter.pipeline.formats import check_writable
from kinefilter.pipeline.formats.files import LARGEST_TOML, read_limited
from kinefilter.pipeline.settings import Settings, fingerprint

from .contacts import check_contacts
from .local import LocalStore
from .naming import clip_names
from .row import Row
from .sources import Source
from .store import Found, Store, real

_ZIPPED = 4  # times as long as its file is what was zipped: numbers give 2 to 10


@dataclass(frozen=True)
class Job:
    """A take to clean; goes to other processes as it is."""

    source: Source
    """The take's file."""
    store: Store
    """Where the clip goes."""
    output: str
    """Its path there, without a person's number."""
    settings: Settings
    """What is done."""
    fingerprint: str
    """A hash of that."""

    @property
    def size(self) -> int:
        """About how many bytes of text the take has, for how long it will take."""
        file = self.source.file
        return file.size * (_ZIPPED if file.name.lower().endswith(".gz") else 1) + 1


def plan_jobs(
    sources: Sequence[Source],
    store: Store,
    settings: Settings,
    suffix: str,
    *,
    files: Sequence[SettingsFile] = (),
    given: Collection[str] = (),
) -> list[Job]:
    """Return a job for every file, the longest first.

    Settings of ``kinefilter.toml`` in a take's folder, and in those above it up to the
    one that was searched, are stronger than ``files``; the nearest is the strongest.

    Args:
        sources: Files to look at.
        store: Where clips go.
        settings: What holds where no file says anything.
        suffix: Extension of the clips, such as ``.usdc``.
        files: Files of settings for all takes, the strongest last.
        given: Names of settings that no file may change, as the user gave them.

    Raises:
        InputError: A file of settings is wrong, contacts of one take are given to
            several, or a clip would overwrite a take.
    """
    folders = _Folders(overlaid(settings, files, given), given, suffix, store)
    chosen = [folders.settings_of(source) for source in sources]
    check_contacts(
        (source, settings)
        for source, (settings, _) in zip(sources, chosen, strict=True)
    )
    several = any(settings.body == "all" for settings, _ in chosen)
    takes = [source.take for source in sources]
    names = clip_names(takes, suffix, several=several)
    jobs = [
        Job(source, store, name, *own)
        for source, name, own in zip(sources, names, chosen, strict=True)
    ]
    _keep_takes(jobs, store)
    return sorted(jobs, key=lambda job: (-job.size, job.source.take))


class _Folders:
    """The settings of folders, each read once."""

    def __init__(
        self, settings: Settings, given: Collection[str], suffix: str, out: Store
    ) -> None:
        self._settings, self._given = settings, given
        self._suffix, self._out = suffix, out
        self._known: dict[tuple[str, str], Settings] = {}
        self._checked: dict[Settings, str] = {}

    def settings_of(self, source: Source) -> tuple[Settings, str]:
        """Return settings and their fingerprint."""
        folder = PurePosixPath(source.file.name).parent
        settings = self._inherited(source.store, folder)
        if settings not in self._checked:
            _check(settings, self._out, self._suffix)
            self._checked[settings] = fingerprint(settings, self._suffix)
        return settings, self._checked[settings]

    def _inherited(self, store: Store, folder: PurePosixPath) -> Settings:
        key = store.root, str(folder)
        if key not in self._known:
            above = self._settings
            if folder != folder.parent:
                above = self._inherited(store, folder.parent)
            file = _settings_file(store, str(folder / FOLDER_FILE))
            own = [] if file is None else [file]
            self._known[key] = overlaid(above, own, self._given)
        return self._known[key]


def _settings_file(store: Store, name: str) -> SettingsFile | None:
    if store.found(name) is None:
        return None
    with store.reading(name) as path:
        text = read_limited(path, LARGEST_TOML)
    folder = Path(store.path(name)).parent if isinstance(store, LocalStore) else None
    return parse_settings(text, store.path(name), folder)


def _check(settings: Settings, out: Store, suffix: str) -> None:
    """Raise what every take of a folder would fail by."""
    where = Path(tempfile.gettempdir()) / f"clip{suffix}"
    check_writable(where, settings.export)
    layer = settings.export.character
    if layer is not None and not (layer.is_file() and isinstance(out, LocalStore)):
        raise InputError(
            f"--character {layer}: many clips can only refer to a layer of this "
            "machine that is there; write it with 'kinefilter clean --character'"
        )


def _keep_takes(jobs: Sequence[Job], store: Store) -> None:
    """Raise an InputError if a clip would overwrite a take."""
    takes, root = {job.source.place for job in jobs}, real(store.root)
    for job in jobs:
        if f"{root}/{job.output}" in takes:
            raise InputError(
                f"{job.store.path(job.output)}: would overwrite a take; write into "
                "another folder"
            )


def is_done(job: Job, row: Row | None, written: Mapping[str, Found]) -> bool:
    """Tell whether a job was done by an earlier run, and what it wrote is there.

    A file is the same if size and time are, and otherwise if its bytes are: so that
    nothing is read twice, and a copied folder is not cleaned again.

    Args:
        job: What there is to do.
        row: The last row of its take.
        written: What is in the output folder, by name.
    """
    if row is None or row.status == "failed" or row.settings != job.fingerprint:
        return False
    source = job.source
    same = source.file.stamp == row.stamp or (
        source.store.sha256(source.file.name) == row.sha256
    )
    return (same and row.output == job.output) and all(
        (file := written.get(clip.output)) is not None
        and (file.stamp == clip.stamp or job.store.sha256(file.name) == clip.sha256)
        for clip in row.clips
    )
