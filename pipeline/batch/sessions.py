"""Files that may be takes, and which of them are of one session by their names.

By ``{name}_{sensor}.csv*`` takes that differ only in ``{sensor}`` are of one session;
``*`` and ``?`` are as in a shell. The pattern is that of the end of a path, so that
``{name}/{sensor}.csv`` has a folder for each session and ``{sensor}/{name}.csv`` one
for each sensor. ``{sensor}`` is as short as can be, unless the names are known.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from kinefilter.characters import InputError
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats.plain import printable
from kinefilter.pipeline.formats.takes import claims_take
from kinefilter.pipeline.settings import Settings

from .store import Store, StoredFile

_CERTAIN = (".skeleton", ".bvh")  # extensions that only takes have
_WILD = {"{name}": "(?P<name>[^/]+)", "*": "[^/]*", "?": "[^/]"}


@dataclass(frozen=True)
class Source:
    """A file that may be a take."""

    take: str  # its name in the manifest: the path below the folder that was searched
    store: Store
    place: str  # its path without links, or its URL
    file: StoredFile
    named: bool  # by the user, this very file: then it is a take

    def is_take(self, path: Path, layout: TakeFormat | None) -> bool:
        """Tell a take, even a broken one, from other files.

        The file, or a copy of it, is read at ``path``; ``layout`` is the one that the
        user gave for all files. Raises InputError if it cannot be read.
        """
        name = self.file.name.lower().removesuffix(".gz")
        certain = self.named or layout is not None or name.endswith(_CERTAIN)
        return certain or claims_take(path)


class Session(NamedTuple):
    """Files that make one clip: a take of each sensor, or a take by itself."""

    take: str  # its name in the manifest
    sources: tuple[Source, ...]
    sensors: tuple[str, ...]  # that the pattern finds in the names of the files
    settings: Settings


def find_sessions(
    sources: Sequence[Source], chosen: Sequence[Settings]
) -> list[Session]:
    """Return the sessions that files are of, by the pattern in the settings of each.

    A take without a partner stays by itself, and so does what has no such name. Raises
    InputError if a pattern is that of no file, or there are sensors without a pattern.
    """
    alone, unused = list[Session](), dict[str, str]()
    found: dict[tuple[str, str, str], list[Session]] = {}
    for source, settings in zip(sources, chosen, strict=True):
        pattern, place = settings.sessions or "", source.store.path(source.file.name)
        match = _expression(pattern, settings.sensors).fullmatch(Path(place).as_posix())
        if match is None or not pattern:
            own = replace(settings, sessions=None, sensors=(), calibration=None)
            alone.append(Session(source.take, (source,), (), own))
            unused.setdefault(pattern, place)
            continue
        take = Session(source.take, (source,), (match["sensor"],), settings)
        found.setdefault((match["folder"], match["name"], pattern), []).append(take)
    used = {pattern for _, _, pattern in found}
    for pattern, place in unused.items():
        if pattern and pattern not in used:
            raise InputError(
                f"--sessions {pattern}: no take is called so, {place} for one; give a "
                "pattern such as {name}_{sensor}.csv* for walk_left.csv, and --sensors "
                "as the names have them"
            )
    if not used and (
        sensors := next((one.sensors for one in chosen if one.sensors), ())
    ):
        raise InputError(f"--sensors {' '.join(sensors)}: are of --sessions; give both")
    return alone + [
        _joined(name, pattern, t) for (_, name, pattern), t in found.items()
    ]


def _joined(name: str, pattern: str, takes: Sequence[Session]) -> Session:
    """Return takes of one sensor each as one session, in the order of the sensors."""
    if len(takes) == 1:
        return takes[0]
    order = {sensor: k for k, sensor in enumerate(takes[0].settings.sensors)}
    first, *others = sorted(
        takes, key=lambda one: (order.get(one.sensors[0], 0), one.sensors, one.take)
    )
    folders = PurePosixPath(first.take).parents
    folder = folders[min(pattern.count("/"), len(folders) - 1)]
    return first._replace(
        take=str(folder / printable(name)),
        sources=(*first.sources, *(one.sources[0] for one in others)),
        sensors=(*first.sensors, *(one.sensors[0] for one in others)),
    )


@cache
def _expression(pattern: str, sensors: tuple[str, ...]) -> re.Pattern[str]:
    known = "|".join(map(re.escape, sensors)) or "[^/]+?"
    wild = _WILD | {"{sensor}": f"(?P<sensor>{known})"}
    parts = re.split(r"(\{name\}|\{sensor\}|[*?])", pattern)
    text = "".join(wild.get(part) or re.escape(part) for part in parts)
    return re.compile(f"(?P<folder>(?:.*/)?){text}", re.DOTALL)
