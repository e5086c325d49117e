"""What there is to do: a job for each take, with the settings of its folder."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

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

from .manifest import Row, Status
from .sources import Source, clip_names
from .store import Store, StoredFile, canonical

_ZIPPED = 4  # size of text over that of its gzip file: numbers give 2 to 10


@dataclass(frozen=True)
class Job:
    """A take to clean; can be sent to other processes."""

    source: Source
    store: Store  # where the clip is written
    output: str  # the clip's path there, without a person's number
    settings: Settings
    fingerprint: str  # of the settings

    @property
    def size(self) -> int:
        """About how many bytes of text the take has, to estimate its duration."""
        file = self.source.file
        return file.size * (_ZIPPED if file.name.lower().endswith(".gz") else 1) + 1

    def row(self, status: Status, **known: Any) -> Row:
        """Return what became of the take."""
        known |= {"settings": self.fingerprint}
        source = self.source
        return Row(source.take, status, self.output, source.file.stamp, **known)

    def is_done(self, row: Row, written: Mapping[str, StoredFile]) -> bool:
        """Tell whether an earlier run did this job, and its clips are still there.

        A file is the same if size and time are, or else if its bytes are. So nothing is
        read twice, and a copied folder is not cleaned again.
        """
        if row.status == "failed" or row.settings != self.fingerprint:
            return False
        source, file = self.source.store, self.source.file
        same = file.stamp == row.stamp or source.sha256(file.name) == row.sha256
        return (same and row.output == self.output) and all(
            (found := written.get(clip.output)) is not None
            and (
                found.stamp == clip.stamp
                or self.store.sha256(found.name) == clip.sha256
            )
            for clip in row.clips
        )


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

    Values of ``settings`` hold where no file sets others: of ``files``, later ones
    override earlier ones, and ``kinefilter.toml`` in a take's folder, and in those
    above it up to the one that was searched, overrides these, the nearest first. No
    file may change the settings ``given`` by the user. Clips end in ``suffix``, such as
    ``.usdc``. Raises InputError if a file of settings is wrong, contacts of one take
    are given to several, or a clip would overwrite a take.
    """
    known: dict[tuple[str, str], Settings] = {}

    def settings_of(store: Store, folder: PurePosixPath) -> Settings:
        key = store.root, str(folder)
        if key not in known:
            top = folder == folder.parent
            above = start if top else settings_of(store, folder.parent)
            name = str(folder / FOLDER_FILE)
            own = [] if store.find(name) is None else [_settings_file(store, name)]
            known[key] = overlaid(above, own, given)
        return known[key]

    start = overlaid(settings, files, given)
    chosen = [
        settings_of(source.store, PurePosixPath(source.file.name).parent)
        for source in sources
    ]
    fingerprints = {}
    for one in dict.fromkeys(chosen):
        _check(one, store, suffix)
        fingerprints[one] = fingerprint(one, suffix)
    _check_contacts(zip(sources, chosen, strict=True))
    several = any(one.body == "all" for one in chosen)
    names = clip_names([source.take for source in sources], suffix, several=several)
    jobs = [
        Job(source, store, name, one, fingerprints[one])
        for source, name, one in zip(sources, names, chosen, strict=True)
    ]
    takes, root = {source.place for source in sources}, canonical(store.root)
    for job in jobs:
        if f"{root}/{job.output}" in takes:
            raise InputError(
                f"{store.path(job.output)}: would overwrite a take; write into another "
                "folder"
            )
    return sorted(jobs, key=lambda job: (-job.size, job.source.take))


def _settings_file(store: Store, name: str) -> SettingsFile:
    with store.reading(name) as path:
        text = read_limited(path, LARGEST_TOML)
    folder = Path(store.path(name)).parent if store.is_local else None
    return parse_settings(text, store.path(name), folder)


def _check(settings: Settings, out: Store, suffix: str) -> None:
    """Raise an InputError that every take with these settings would raise."""
    where = Path(tempfile.gettempdir()) / f"clip{suffix}"
    check_writable(where, settings.export)
    layer = settings.export.character
    if layer is not None and not (layer.is_file() and out.is_local):
        raise InputError(
            f"--character {layer}: the clips of a batch can only refer to a layer that "
            "exists on this machine; write it with 'kinefilter clean --character'"
        )


def _check_contacts(planned: Iterable[tuple[Source, Settings]]) -> None:
    """Raise an InputError if a file of contacts would be used for several people."""
    takes: dict[Path, str] = {}
    for source, settings in planned:
        file = settings.config.contacts
        if file is None or not _is_take(source, settings):
            continue
        if settings.body == "all":
            raise InputError(
                f"--contacts {file}: is for one person; choose the person with --body"
            )
        if file in takes:
            raise InputError(
                f"--contacts {file}: is for one take, not for both {takes[file]} and "
                f"{source.take}; put that take in a folder of its own, with a "
                "kinefilter.toml that sets it, or use 'kinefilter clean'"
            )
        takes[file] = source.take


def _is_take(source: Source, settings: Settings) -> bool:
    """Tell takes from other files; a file that cannot be read fails in its own job."""
    try:
        with source.store.reading(source.file.name) as path:
            return source.is_take(path, settings.format)
    except InputError:
        return False
