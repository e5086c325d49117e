"""What there is to do: which files may be takes, and a job for each."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from kinefilter.pipeline.formats.plain import printable
from kinefilter.pipeline.settings import Settings, fingerprint

from .manifest import Row, Status
from .sessions import Source, find_sessions
from .store import Store, StoredFile, canonical, is_folder, is_url, store_at

_TAKES = (".csv", ".txt", ".json", ".skeleton", ".bvh", ".npy", ".trc", ".c3d")
"""Extensions of files that may be takes, zipped (``.gz``) or not."""
_SESSION = ".session"  # instead of the extension that a session does not have
_ZIPPED = 4  # size of text over that of its gzip file: numbers give 2 to 10
_LONGEST_NAME = 230  # bytes, of the 255 of a file's name, for numbers and extensions
_LONGEST_TAKE, _LONGEST_BYTE = 3600.0, 60.0 / 1e6
"""Time limit [s] of a take, and more for each of its bytes; the default method needs
3 s for a megabyte of one person. A guess."""


def find_sources(inputs: Sequence[str], out: str) -> list[Source]:
    """Return the named files, and those in folders with an extension of takes.

    A file that is found twice counts once. With several inputs, the takes of a folder
    are prefixed with the folder's name. Raises InputError if an input does not exist or
    is ``out``, nothing was found, or a name is empty, as an unset variable makes it.
    """
    if "" in (*inputs, out):
        raise InputError("an empty name; give . for the current folder")
    sources: dict[str, Source] = {}
    labels: Counter[str] = Counter()
    for place in inputs:
        if not is_folder(place):
            path = place if is_url(place) else Path(place).absolute().as_posix()
            folder, _, name = path.rpartition("/")
            store = store_at(f"{folder}/")
            file = store.find(name)
            if file is None:
                raise InputError(
                    f"{place}: there is no such file or folder; check the name"
                )
            at = canonical(place)
            sources.setdefault(at, Source(name, store, at, file, named=True))
            continue
        prefix = ""
        if len(inputs) > 1:
            label = Path(place).name
            if label in ("", ".."):
                label = PurePosixPath(canonical(place)).name
            labels[label] += 1
            prefix = f"{label}-{labels[label]}/" if labels[label] > 1 else f"{label}/"
        for source in _in_folder(place, out):
            named = replace(source, take=prefix + source.take)
            sources.setdefault(source.place, named)
    if not sources:
        raise InputError(
            f"{', '.join(inputs)}: no file with an extension of takes ("
            f"{', '.join(_TAKES)}, or .gz of these); check the name"
        )
    names = unique_names(printable(source.take) for source in sources.values())
    return [
        replace(source, take=name)
        for source, name in zip(sources.values(), names, strict=True)
    ]


def _in_folder(place: str, out: str) -> list[Source]:
    store, root = store_at(place), canonical(place)
    if root == canonical(out):
        raise InputError(
            f"{out}: is also searched for takes; write into another folder, which may "
            "be inside it"
        )
    # If the output is inside the searched folder, it is left out.
    written = f"{canonical(out)}/".removeprefix(f"{root}/")
    return [
        Source(file.name, store, f"{root}/{file.name}", file, named=False)
        for file in store.files()
        if file.name.lower().removesuffix(".gz").endswith(_TAKES)
        and not file.name.startswith(written)
    ]


def clip_names(
    takes: Sequence[str], suffix: str, *, several: bool = False
) -> list[str]:
    """Return the path of each take's clip, no two the same.

    ``walks/fast.csv.gz`` becomes ``walks/fast.usdc``. Takes that differ only in their
    extension keep it: ``fast.csv.usdc`` and ``fast.bvh.usdc``. So a name depends on
    which other takes there are, but not on their order. Names too long for a file
    are cut. With ``several``, takes may give a clip for each of several people or parts
    (``numbered``).
    """

    def key(name: str) -> str:
        # Numbers at its end could be those of people or parts.
        return re.sub(r"(\.(part)?\d+)+$" if several else "$", "", name.casefold())

    plain = [re.sub(r"(?<=[^/])\.gz$", "", take, flags=re.IGNORECASE) for take in takes]
    names, longer = list[str](), [str(PurePosixPath(p).with_suffix("")) for p in plain]
    while names != longer:
        names, counts = longer, Counter(map(key, longer))
        longer = [
            take if counts[key(name)] > 1 else name
            for take, name in zip(takes, names, strict=True)
        ]
    shortened = (_shortened(name) for name in names)
    return [name + suffix for name in unique_names(shortened, str.casefold)]


def _shortened(name: str) -> str:
    """Return a path whose last part is no longer than file systems allow."""
    folder, slash, last = name.rpartition("/")
    return folder + slash + last.encode()[:_LONGEST_NAME].decode(errors="ignore")


def unique_names(names: Iterable[str], key: Callable[[str], str] = str) -> list[str]:
    """Return names, each but the first of those with the same key prefixed by a number.

    The number is put before the last part of a path, which is split by ``/``.
    """
    taken: dict[str, int] = {}  # and the number that was given last for it
    unique = []
    for name in names:
        free, known = name, key(name)
        while key(free) in taken:
            taken[known] += 1
            folder, slash, last = name.rpartition("/")
            free = f"{folder}{slash}{taken[known]}-{last}"
        taken[key(free)] = 1
        unique.append(free)
    return unique


@dataclass(frozen=True)
class Job:
    """A take, or a session of several sensors, to clean; can be sent elsewhere."""

    take: str  # its name in the manifest
    sources: tuple[Source, ...]  # one, or one of each sensor
    sensors: tuple[str, ...]  # their names; empty where no pattern says so
    settings: Settings
    store: Store  # where the clip is written
    output: str  # the clip's path there, without the number of a person or part
    fingerprint: str  # of the settings
    take_timeout: float | None = None  # s; by default it depends on the size

    @property
    def limit(self) -> float:
        """How many seconds the take may need."""
        longest = _LONGEST_TAKE + _LONGEST_BYTE * self.size
        return longest if self.take_timeout is None else self.take_timeout

    @property
    def size(self) -> int:
        """About how many bytes of text the take has, to estimate its duration."""
        return 1 + sum(
            file.size * (_ZIPPED if file.name.lower().endswith(".gz") else 1)
            for file in (source.file for source in self.sources)
        )

    @property
    def stamp(self) -> str:
        """Size and time of the take's files."""
        return " ".join(source.file.stamp for source in self.sources)

    def row(self, status: Status, **known: Any) -> Row:
        """Return what became of the take."""
        sensors = tuple(
            {"sensor": sensor, "source": source.take}
            for sensor, source in zip(self.sensors, self.sources, strict=False)
        )
        known = {"settings": self.fingerprint, "sensors": sensors} | known
        return Row(self.take, status, self.output, self.stamp, **known)

    def is_done(self, row: Row, written: Mapping[str, StoredFile]) -> bool:
        """Tell whether an earlier run did this job, and its clips are still there.

        A file is the same if size and time are, or else if its bytes are. So nothing is
        read twice, and a copied folder is not cleaned again.
        """
        if row.status == "failed" or row.settings != self.fingerprint:
            return False
        try:
            same = self.stamp == row.stamp or row.sha256 == " ".join(
                source.store.sha256(source.file.name) for source in self.sources
            )
            return (same and row.output == self.output) and all(
                (found := written.get(clip.output)) is not None
                and (
                    found.stamp == clip.stamp
                    or self.store.sha256(found.name) == clip.sha256
                )
                for clip in row.clips
            )
        except InputError:  # cannot be read, as its own job will tell
            return False


def plan_jobs(
    sources: Sequence[Source],
    store: Store,
    settings: Settings,
    suffix: str,
    *,
    files: Sequence[SettingsFile] = (),
    given: Collection[str] = (),
    take_timeout: float | None = None,
) -> list[Job]:
    """Return a job for every take and every session, the longest first.

    Values of ``settings`` hold where no file sets others: of ``files``, later ones
    override earlier ones, and ``kinefilter.toml`` in a take's folder, and in those
    above it up to the one that was searched, overrides these, the nearest first. No
    file may change the settings ``given`` by the user. Clips end in ``suffix``, such as
    ``.usdc``. Of a session the settings of its first take hold. Raises InputError if a
    file of settings is wrong, contacts of one take are given to several, a pattern of
    sessions is that of no take, or a clip would overwrite a take.
    """
    known: dict[tuple[str, str], Settings] = {}

    def settings_of(store: Store, folder: PurePosixPath) -> Settings:
        key = store.root, str(folder)
        if key not in known:
            top = folder == folder.parent
            above = start if top else settings_of(store, folder.parent)
            own, name = [], str(folder / FOLDER_FILE)
            if store.find(name) is not None:
                with store.reading(name) as path:
                    text = read_limited(path, LARGEST_TOML)
                place = store.path(name)
                relative_to = Path(place).parent if store.is_local else None
                own = [parse_settings(text, place, relative_to)]
            known[key] = overlaid(above, own, given)
        return known[key]

    start = overlaid(settings, files, given)
    chosen = [
        settings_of(source.store, PurePosixPath(source.file.name).parent)
        for source in sources
    ]
    for one in dict.fromkeys(chosen):
        _check(one, store, suffix)
    found = find_sessions(sources, chosen)
    takes = unique_names(session.take for session in found)
    sessions = [
        session._replace(take=take) for session, take in zip(found, takes, strict=True)
    ]
    several = any(one.body == "all" or one.config.gaps == "split" for one in chosen)
    called = [one.take + _SESSION * (len(one.sources) > 1) for one in sessions]
    names = clip_names(called, suffix, several=several)
    fingerprints = {
        one: fingerprint(one, suffix)
        for one in dict.fromkeys(session.settings for session in sessions)
    }
    jobs = [
        Job(*session, store, name, fingerprints[session.settings], take_timeout)
        for session, name in zip(sessions, names, strict=True)
    ]
    _check_contacts(jobs)
    places, root = {source.place for source in sources}, canonical(store.root)
    for job in jobs:
        if f"{root}/{job.output}" in places:
            raise InputError(
                f"{store.path(job.output)}: would overwrite a take; write into another "
                "folder"
            )
    return sorted(jobs, key=lambda job: (-job.size, job.take))


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
    if settings.calibration is not None:
        from kinefilter.pipeline.merge import read_calibration

        read_calibration(settings.calibration)


def _check_contacts(jobs: Iterable[Job]) -> None:
    """Raise an InputError if contacts or edits would be used for several people."""
    takes: dict[tuple[str, Path], str] = {}
    for job in jobs:
        settings, source = job.settings, job.sources[0]
        config = settings.config
        given = {"--contacts": config.contacts, "--edits": config.edits}
        files = [(flag, file) for flag, file in given.items() if file is not None]
        if not files:
            continue
        try:
            with source.store.reading(source.file.name) as path:
                if not source.is_take(path, settings.format):
                    continue
        except InputError:  # in its own job, it fails for this
            continue
        for flag, file in files:
            if settings.body == "all":
                raise InputError(f"{flag} {file}: is for one person; choose by --body")
            if (flag, file) in takes:
                raise InputError(
                    f"{flag} {file}: is for one take, not for both "
                    f"{takes[flag, file]} and {job.take}; put that take in a folder of "
                    "its own, with a kinefilter.toml that sets it, or use "
                    "'kinefilter clean'"
                )
            takes[flag, file] = job.take
