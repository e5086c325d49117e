"""Files that may be takes, and their grouping into sessions by name.

With the pattern ``{name}_{sensor}.csv*``, takes whose names differ only in ``{sensor}``
form a session; ``*`` and ``?`` match as in a shell. A pattern matches the end of a
path, and ``{sensor}`` as little as possible, or one of the given names.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from kinefilter.characters import InputError
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats.files import beginning
from kinefilter.pipeline.formats.plain import printable
from kinefilter.pipeline.formats.takes import claims_take
from kinefilter.pipeline.settings import Settings

from .store import Store, StoredFile

_TAKES_ONLY = (".skeleton", ".bvh")  # extensions that nothing else uses
_CLIP = re.compile(r"ROOT (HipCenter|SpineBase)\s.*Pivot\s", re.DOTALL)
"""How our own BVH begins, on the skeleton of a take."""
_WILDCARDS = {"{name}": "(?P<name>[^/]+)", "*": "[^/]*", "?": "[^/]"}


@dataclass(frozen=True)
class Source:
    """A file that may be a take."""

    take: str  # its name in the manifest: the path below the searched folder
    store: Store
    place: str  # its path with links resolved, or its URL
    file: StoredFile
    named: bool  # True if the user named this file, so that it must be a take

    def is_take(self, path: Path, layout: TakeFormat | None) -> bool:
        """Return True if the file is a take, even a broken one, but not our own clip.

        The file or a copy of it is read from ``path``; a ``layout`` given by the user
        makes every file a take. Raises InputError if the file cannot be read.
        """
        name = self.file.name.lower().removesuffix(".gz")
        if self.named or layout is not None:
            return True
        if name.endswith(".bvh") and _CLIP.search(beginning(path, 1000)):
            return False
        return name.endswith(_TAKES_ONLY) or claims_take(path)


class Session(NamedTuple):
    """Files that make one clip: one take per sensor, or a single take."""

    take: str  # its name in the manifest
    sources: tuple[Source, ...]
    sensors: tuple[str, ...]  # as matched in the file names; empty without a pattern
    settings: Settings


def find_sessions(sources: Sequence[Source], each: Sequence[Settings]) -> list[Session]:
    """Group files into sessions by the pattern in the settings of ``each``.

    A take without a partner, or whose name does not match, is a session of its own.
    Raises InputError if a pattern matches no file, or sensors or a calibration are
    given without one.
    """
    alone, unmatched = list[Session](), dict[str, str]()
    groups: dict[tuple[str, str, str], list[Session]] = {}
    for source, settings in zip(sources, each, strict=True):
        pattern, place = settings.sessions or "", source.store.path(source.file.name)
        match = _expression(pattern, settings.sensors).fullmatch(Path(place).as_posix())
        if match is None or not pattern:
            own = replace(settings, sessions=None, sensors=(), calibration=None)
            alone.append(Session(source.take, (source,), (), own))
            unmatched.setdefault(pattern, place)
            continue
        take = Session(source.take, (source,), (match["sensor"],), settings)
        key = match["folder"], match["name"], pattern
        groups.setdefault(key, []).append(take)
    used = {pattern for _, _, pattern in groups}
    for pattern, place in unmatched.items():
        if pattern and pattern not in used:
            raise InputError(
                f"--sessions {pattern}: matches no take (one of them is {place}); use "
                "a pattern such as {name}_{sensor}.csv* for walk_left.csv, and spell "
                "--sensors as in the file names"
            )
    for settings in each:
        if settings.sensors and not used:
            names = " ".join(settings.sensors)
            raise InputError(f"--sensors {names}: requires --sessions")
        if settings.calibration and not used:
            file = settings.calibration
            raise InputError(f"--calibration {file}: requires --sessions")
    return alone + [_joined(*key[1:], takes) for key, takes in groups.items()]


def _joined(name: str, pattern: str, takes: Sequence[Session]) -> Session:
    """Join takes of one sensor each into a session, in the order of the sensors."""
    if len(takes) == 1:
        return takes[0]
    order = {sensor: k for k, sensor in enumerate(takes[0].settings.sensors)}
    takes = sorted(takes, key=lambda t: (order.get(t.sensors[0], 0), t.sensors, t.take))
    folders = PurePosixPath(takes[0].take).parents
    folder = folders[min(pattern.count("/"), len(folders) - 1)]
    return takes[0]._replace(
        take=str(folder / printable(name)),
        sources=tuple(one.sources[0] for one in takes),
        sensors=tuple(one.sensors[0] for one in takes),
    )


@cache
def _expression(pattern: str, sensors: tuple[str, ...]) -> re.Pattern[str]:
    sensor = "|".join(map(re.escape, sensors)) or "[^/]+?"
    wildcards = _WILDCARDS | {"{sensor}": f"(?P<sensor>{sensor})"}
    parts = re.split(r"(\{name\}|\{sensor\}|[*?])", pattern)
    text = "".join(wildcards.get(part) or re.escape(part) for part in parts)
    return re.compile(f"(?P<folder>(?:.*/)?){text}", re.DOTALL)
