"""Planning a batch: the files that may be takes, and a job for each clip."""

import re
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.edits import edits_beside
from kinefilter.pipeline.formats import check_writable
from kinefilter.pipeline.formats.files import LARGEST_TOML, read_limited
from kinefilter.pipeline.formats.keypoints import recording_of_frame
from kinefilter.pipeline.formats.plain import printable
from kinefilter.pipeline.settings import (
    FOLDER_FILE,
    Settings,
    as_table,
    fingerprint,
    overlaid,
    parse_settings,
)

from .manifest import Row, Status
from .sessions import Session, Source, find_sessions
from .store import Store, StoredFile, canonical, is_folder, is_url, store_at

_TAKES = (".csv", ".txt", ".json", ".skeleton", ".bvh", ".npy", ".trc", ".c3d")
"""Extensions of files that may be takes, compressed (``.gz``) or not."""
_SESSION = ".session"  # stands in for an extension, which a session lacks
_COMPRESSION = 4  # size of text relative to its gzip file; 2 to 10 for numbers
_MAX_NAME = 230  # bytes of a file name; 255 are allowed, with numbers and extensions
_TIME_PER_TAKE, _TIME_PER_BYTE = 3600.0, 60.0 / 1e6
"""Default time limit [s] of a take, and per byte of it: a guess. The default method
needs 3 s for a megabyte of one person."""


def find_sources(inputs: Sequence[str], out: str) -> list[Source]:
    """Return the given files, and those in given folders with an extension of takes.

    A file found twice counts once. With several inputs, the names of a folder's takes
    are prefixed with the folder's name. Raises InputError if an input does not exist or
    is ``out``, no file is found, or a name is empty (as from an unset shell variable).
    """
    if "" in (*inputs, out):
        raise InputError("got an empty name; use . for the current folder")
    sources: dict[str, Source] = {}
    labels: Counter[str] = Counter()
    for place in inputs:
        if not is_folder(place):
            path = place if is_url(place) else Path(place).absolute().as_posix()
            folder, _, name = path.rpartition("/")
            store = store_at(f"{folder}/")
            file = store.find(name)
            if file is None:
                raise InputError(f"{place}: no such file or folder; check the name")
            key = canonical(place)
            sources.setdefault(key, Source(name, store, key, file, named=True))
            continue
        prefix = ""
        if len(inputs) > 1:
            label = Path(place).name
            if label in ("", ".."):
                label = PurePosixPath(canonical(place)).name
            labels[label] += 1
            prefix = f"{label}-{labels[label]}/" if labels[label] > 1 else f"{label}/"
        for source in _in_folder(place, out, prefix):
            sources.setdefault(source.place, source)
    if not sources:
        raise InputError(
            f"{', '.join(inputs)}: contains no takes, files ending in "
            f"{', '.join(_TAKES)}, or .gz of these; check the name"
        )
    names = unique_names(printable(source.take) for source in sources.values())
    pairs = zip(sources.values(), names, strict=True)
    return [replace(source, take=name) for source, name in pairs]


def _in_folder(place: str, out: str, prefix: str) -> list[Source]:
    store, root = store_at(place), canonical(place)
    if root == canonical(out):
        hint = "write into another folder, for example inside it"
        raise InputError(f"{out}: is also searched for takes; {hint}")
    files = [*store.files()]
    for name in (file.name for file in files):
        last = name.rpartition("/")[2]
        if last.lower() == FOLDER_FILE != last:
            wrong = "is not read, as its name is not all lower case"
            raise InputError(f"{store.path(name)}: {wrong}; call it {FOLDER_FILE}")
    # Output inside the searched folder is skipped.
    written = f"{canonical(out)}/".removeprefix(f"{root}/")
    files = [file for file in files if not file.name.startswith(written)]
    return [
        Source(prefix + file.name, store, f"{root}/{file.name}", file, named=False)
        for file in _without_later_frames(files)
        if file.name.lower().removesuffix(".gz").endswith((*_TAKES, "/*"))
    ]


def _without_later_frames(files: Iterable[StoredFile]) -> Iterator[StoredFile]:
    """Yield files in order; of the frames of OpenPose, the first stands for all."""
    seen = set[str]()
    for file in files:
        folder, _, name = file.name.rpartition("/")
        if (recording := recording_of_frame(name)) is not None:
            if (whole := f"{folder}/{recording}") in seen:
                continue
            seen.add(whole)
        yield file


def clip_names(
    takes: Sequence[str], suffix: str, *, several: bool = False
) -> list[str]:
    """Return a unique path for each take's clip.

    ``walks/fast.csv.gz`` becomes ``walks/fast.usdc``. Takes that differ only in their
    extension keep it: ``fast.csv.usdc`` and ``fast.bvh.usdc``. A path thus depends on
    the other takes, but not on their order. Names too long for a file are cut. With
    ``several``, leave room for the numbers of people or parts (``numbered``).
    """

    def key(name: str) -> str:
        # Trailing numbers could be those of people or parts.
        return re.sub(r"(\.(part)?\d+)+$" if several else "$", "", name.casefold())

    plain = [re.sub(r"(?<=[^/])\.gz$", "", take, flags=re.IGNORECASE) for take in takes]
    names, longer = list[str](), [str(PurePosixPath(p).with_suffix("")) for p in plain]
    while names != longer:
        names, counts = longer, Counter(map(key, longer))
        pairs = zip(takes, names, strict=True)
        longer = [take if counts[key(name)] > 1 else name for take, name in pairs]
    return [name + suffix for name in unique_names(map(_cut, names), str.casefold)]


def _cut(name: str) -> str:
    folder, slash, last = name.rpartition("/")
    return folder + slash + last.encode()[:_MAX_NAME].decode(errors="ignore")


def unique_names(names: Iterable[str], key: Callable[[str], str] = str) -> list[str]:
    """Make names unique by prefixing duplicates with a number.

    Names with the same key are duplicates. In a path, the last part gets the number.
    """
    taken: dict[str, int] = {}  # the last number used for each key
    unique = []
    for name in names:
        free, own = name, key(name)
        while key(free) in taken:
            taken[own] += 1
            folder, slash, last = name.rpartition("/")
            free = f"{folder}{slash}{taken[own]}-{last}"
        taken[key(free)] = 1
        unique.append(free)
    return unique


@dataclass(frozen=True)
class Job:
    """A take or session to clean; can be sent to other processes."""

    take: str  # its name in the manifest
    sources: tuple[Source, ...]  # one, or one per sensor
    sensors: tuple[str, ...]  # their names; empty without a pattern of sessions
    settings: Settings
    store: Store  # where the clip is written
    output: str  # path of the clip there, without the number of a person or part
    fingerprint: str  # of the settings
    take_timeout: float | None = None  # s; by default it depends on the size
    error: str = ""  # why it cannot be cleaned

    @property
    def limit(self) -> float:
        """Time [s] after which the take fails."""
        default = _TIME_PER_TAKE + _TIME_PER_BYTE * self.size
        return default if self.take_timeout is None else self.take_timeout

    @property
    def size(self) -> int:
        """Approximate size of the take as text [bytes], to estimate its duration."""
        files = [source.file for source in self.sources]
        packed = sum(file.size for file in files if file.name.lower().endswith(".gz"))
        return 1 + sum(file.size for file in files) + (_COMPRESSION - 1) * packed

    @property
    def stamp(self) -> str:
        """Size and time of the take's files."""
        return " ".join(source.file.stamp for source in self.sources)

    def row(self, status: Status, **values: Any) -> Row:
        """Return the take's row of the manifest."""
        pairs = zip(self.sensors, self.sources, strict=False)
        sensors = tuple({"sensor": name, "source": one.take} for name, one in pairs)
        options = as_table(self.settings)
        if options.get("edits") == str(_beside(self.sources[0])):
            del options["edits"]
        own = {"settings": self.fingerprint, "options": options, "sensors": sensors}
        return Row(self.take, status, self.output, self.stamp, **own | values)

    def is_done(self, row: Row, written: Mapping[str, StoredFile]) -> bool:
        """Return True if an earlier run did this job and its clips are still there.

        Files are unchanged if size and time are the same, or else their bytes. Thus
        unchanged files are not read again, and copied folders not cleaned again.
        """
        failed = row.status == "failed" or bool(self.error)
        if failed or row.settings != self.fingerprint:
            return False
        try:
            hashes = (source.store.sha256(source.file.name) for source in self.sources)
            same = self.stamp == row.stamp or row.sha256 == " ".join(hashes)
            sha256 = self.store.sha256
            return (same and row.output == self.output) and all(
                (file := written.get(clip.output)) is not None
                and (file.stamp == clip.stamp or sha256(file.name) == clip.sha256)
                for clip in row.clips
            )
        except InputError:  # unreadable, which the job itself will report
            return False


def plan_jobs(
    sources: Sequence[Source],
    out: Store,
    settings: Settings,
    suffix: str,
    *,
    given: Collection[str] = (),
    take_timeout: float | None = None,
) -> list[Job]:
    """Return a job for every take and every session, the longest first.

    Settings are those of ``settings``, overridden by ``kinefilter.toml`` in the folders
    from the searched one down to the take's, except for those ``given`` by the user. A
    session uses the settings of its first take, and the edits beside that
    (``with_edits``). Clips end in ``suffix``, such as ``.usdc``. Raises InputError if a
    settings file is wrong, contacts or edits given for one take would apply to several,
    a pattern of sessions matches no take, or a clip would overwrite a take.
    """

    @cache
    def settings_of(store: Store, folder: PurePosixPath) -> Settings:
        top = folder == folder.parent
        above = settings if top else settings_of(store, folder.parent)
        name = str(folder / FOLDER_FILE)
        if store.find(name) is None:
            return above
        with store.reading(name) as path:
            text = read_limited(path, LARGEST_TOML)
        place = store.path(name)
        relative_to = Path(place).parent if store.is_local else None
        found = overlaid(above, parse_settings(text, place, relative_to), given)
        of_folders[place] = found
        return found

    of_folders: dict[str, Settings] = {}
    chosen = [settings_of(s.store, PurePosixPath(s.file.name).parent) for s in sources]
    _check(settings, out, suffix)
    for place, found in of_folders.items():
        try:
            _check(found, out, suffix)
        except InputError as error:
            raise InputError(f"{place}: {error}") from None
    sessions = [with_edits(session) for session in find_sessions(sources, chosen)]
    takes = unique_names(session.take for session in sessions)
    named = [one._replace(take=take) for one, take in zip(sessions, takes, strict=True)]
    several = any(one.body == "all" or one.config.gaps == "split" for one in chosen)
    stems = [one.take + _SESSION * (len(one.sources) > 1) for one in named]
    names = clip_names(stems, suffix, several=several)
    hashed = cache(partial(fingerprint, suffix=suffix))
    pairs = zip(named, names, strict=True)
    jobs = [Job(*s, out, n, hashed(s.settings), take_timeout) for s, n in pairs]
    jobs = _with_one_person_each(jobs)
    places, root = {source.place for source in sources}, canonical(out.root)
    for job in jobs:
        if f"{root}/{job.output}" in places:
            hint = "choose another output folder"
            raise InputError(f"{out.path(job.output)}: would overwrite a take; {hint}")
    return sorted(jobs, key=lambda job: (-job.size, job.take))


def with_edits(session: Session) -> Session:
    """Return a session that uses the edits beside its first take, if there are any.

    They are not used if the settings name a file of edits or all people are cleaned,
    and not looked for at a URL.
    """
    settings, source = session.settings, session.sources[0]
    named = settings.config.edits is not None or settings.body == "all"
    name = edits_beside(Path(source.file.name)).as_posix()
    if named or not source.store.is_local or source.store.find(name) is None:
        return session
    config = replace(settings.config, edits=_beside(source))
    return session._replace(settings=replace(settings, config=config))


def _beside(source: Source) -> Path:
    return edits_beside(Path(source.store.path(source.file.name)))


def _check(settings: Settings, out: Store, suffix: str) -> None:
    """Raise the InputError that every take with these settings would raise."""
    if settings.config.scene is not None:
        from kinefilter.scenes import load_scene  # loads MuJoCo, which is slow

        load_scene(settings.config.scene)
    check_writable(Path(tempfile.gettempdir()) / f"clip{suffix}", settings.export)
    layer = settings.export.character
    if layer is not None and not (layer.is_file() and out.is_local):
        wrong = "clips of a batch can only refer to a layer that exists on this machine"
        hint = "write it with 'kinefilter clean --character' first"
        raise InputError(f"--character {layer}: {wrong}; {hint}")
    if settings.calibration is not None:
        from kinefilter.pipeline.merge import read_calibration

        read_calibration(settings.calibration)


def _with_one_person_each(jobs: Sequence[Job]) -> list[Job]:
    """Return jobs, with an error for takes beside the same edits."""
    takes: dict[tuple[str, Path], list[str]] = {}
    shared: dict[str, str] = {}
    for job in jobs:
        settings, source = job.settings, job.sources[0]
        config = settings.config
        given = ("--contacts", config.contacts), ("--edits", config.edits)
        files = [(flag, file) for flag, file in given if file is not None]
        if not files:
            continue
        try:
            with source.store.reading(source.file.name) as path:
                if not source.is_take(path, settings.format):
                    continue
        except InputError:  # unreadable, which its own job will report
            continue
        for flag, file in files:
            if settings.body == "all":
                raise InputError(f"{flag} {file}: is for one person; give --body N")
            users = takes.setdefault((flag, file), [])
            users.append(job.take)
            if len(users) > 1 and file == _beside(source):
                why = f"{file}: lies beside {' and '.join(users)}, but is for one take"
                error = f"{why}; move it and its take into a folder of their own"
                shared |= dict.fromkeys(users, error)
            elif len(users) > 1:
                raise InputError(
                    f"{flag} {file}: is for one take, not for both "
                    f"{users[0]} and {job.take}; move the take it belongs to "
                    "into a folder of its own with a kinefilter.toml that names it, or "
                    "use 'kinefilter clean'"
                )
    return [replace(job, error=shared.get(job.take, "")) for job in jobs]
