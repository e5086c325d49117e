"""Which files may be takes, each under a name of its own, and how clips are named."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from kinefilter.characters import InputError
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats.takes import claims_take

from .store import Store, StoredFile, canonical, is_folder, is_url, store_at

_TAKES = (".csv", ".txt", ".json", ".skeleton", ".bvh")
"""Extensions of files that may be takes, zipped (``.gz``) or not."""
_CERTAIN = (".skeleton", ".bvh")
"""Extensions that only takes have."""


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


def find_sources(inputs: Sequence[str], out: str) -> list[Source]:
    """Return the named files, and those in folders with an extension of takes.

    A file that is found twice counts once. With several inputs, the takes of a folder
    are prefixed with the folder's name. Raises InputError if an input does not exist or
    is ``out``, or nothing was found.
    """
    sources: dict[str, Source] = {}
    labels: Counter[str] = Counter()
    for place in inputs:
        found = _in_folder(place, out) if is_folder(place) else [_named_file(place)]
        if len(inputs) > 1 and not (len(found) == 1 and found[0].named):
            label = _label(place, labels)
            found = [replace(one, take=f"{label}/{one.take}") for one in found]
        for source in found:
            sources.setdefault(source.place, source)
    if not sources:
        raise InputError(
            f"{', '.join(inputs)}: no file with an extension of takes ("
            f"{', '.join(_TAKES)}, or .gz of these); check the name"
        )
    names = unique_names(source.take for source in sources.values())
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


def _named_file(place: str) -> Source:
    """Return a file that the user named, whatever its extension."""
    path = place if is_url(place) else str(Path(place).absolute())
    folder, _, name = path.rpartition("/")
    store = store_at(folder or "/")
    file = store.find(name)
    if file is None:
        raise InputError(f"{place}: there is no such file; check the name")
    return Source(name, store, canonical(place), file, named=True)


def _label(place: str, labels: Counter[str]) -> str:
    """Return the prefix of a folder's takes: its name, numbered if it was given."""
    name = PurePosixPath(place).name
    if name in ("", ".."):
        name = PurePosixPath(canonical(place)).name
    labels[name] += 1
    return name if labels[name] == 1 else f"{name}-{labels[name]}"


def clip_names(
    takes: Sequence[str], suffix: str, *, several: bool = False
) -> list[str]:
    """Return the path of each take's clip, no two the same.

    ``walks/fast.csv.gz`` becomes ``walks/fast.usdc``. Takes that differ only in their
    extension keep it: ``fast.csv.usdc`` and ``fast.bvh.usdc``. So a name depends on
    which other takes there are, but not on their order. With ``several``, takes may
    give a clip for each of several people (``numbered``).
    """
    key = _without_number if several else str.casefold
    names, longer = list[str](), [_stem(take) for take in takes]
    while names != longer:
        names, counts = longer, Counter(map(key, longer))
        longer = [
            take if counts[key(name)] > 1 else name
            for take, name in zip(takes, names, strict=True)
        ]
    return [name + suffix for name in unique_names(names, str.casefold)]


def unique_names(names: Iterable[str], key: Callable[[str], str] = str) -> list[str]:
    """Return names, each but the first of those with the same key prefixed by a number.

    The number is put before the last part of a path, which is split by ``/``.
    """
    taken: set[str] = set()
    unique = []
    for name in names:
        path, free, number = PurePosixPath(name), name, 1
        while key(free) in taken:
            number += 1
            free = str(path.with_name(f"{number}-{path.name}"))
        taken.add(key(free))
        unique.append(free)
    return unique


def _without_number(name: str) -> str:
    """Return a name without numbers at its end, which a person's number could match."""
    return re.sub(r"(\.\d+)+$", "", name.casefold())


def _stem(take: str) -> str:
    plain = take[:-3] if take.lower().endswith(".gz") else take
    return str(PurePosixPath(plain).with_suffix(""))
