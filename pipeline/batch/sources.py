"""Which files may be takes, each with a name of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from kinefilter.characters import InputError
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats.takes import claims_take

from .naming import apart
from .places import kind_of, store_at
from .store import Found, Store, is_url, real

_TAKES = (".csv", ".txt", ".json", ".skeleton", ".bvh")
"""Extensions of files that may be takes, zipped (``.gz``) or not."""
_CERTAIN = (".skeleton", ".bvh")
"""Those that nothing but takes has."""


@dataclass(frozen=True)
class Source:
    """A file that may be a take."""

    take: str
    """Path below the folder that was searched, by which the manifest knows it."""
    store: Store
    """What it lies in."""
    place: str
    """Its path without links, or its URL."""
    file: Found
    """Where in the store."""
    named: bool
    """The user named it, so it is a take."""


def find_sources(inputs: Sequence[str], out: str) -> list[Source]:
    """Return the files to look at, of any place those with extensions of takes.

    A file that is found twice counts once. Of several inputs each folder's takes have
    its name in front of theirs.

    Args:
        inputs: Files and folders, paths or URLs.
        out: Folder to write to, which is not searched.

    Raises:
        InputError: An input is not there, nothing is in it, or it is ``out``.
    """
    sources: list[Source] = []
    seen: set[str] = set()
    names: Counter[str] = Counter()
    for place in inputs:
        found = _in_folder(place, out) if _is_folder(place, out) else _alone(place)
        label = _label(place, found, names) if len(inputs) > 1 else ""
        for source in found:
            if source.place not in seen:
                seen.add(source.place)
                sources.append(_labeled(source, label))
    if not sources:
        raise InputError(
            f"{', '.join(inputs)}: no file with an extension of takes ("
            f"{', '.join(_TAKES)}, or .gz of these); check the name"
        )
    return _apart(sources)


def is_take(source: Source, path: Path, layout: TakeFormat | None) -> bool:
    """Tell a file that is a take, or a broken one, from others.

    Args:
        source: The file.
        path: Where it, or a copy, can be read.
        layout: That of all files, if the user said it.

    Raises:
        InputError: The file cannot be read.
    """
    name = source.file.name.lower().removesuffix(".gz")
    certain = source.named or layout is not None or name.endswith(_CERTAIN)
    return certain or claims_take(path)


def _is_folder(place: str, out: str) -> bool:
    """Tell a folder from a file; raise where there is neither."""
    kind = kind_of(place)
    if kind is None:
        raise InputError(f"{place}: there is no such file or folder; check the name")
    if kind == "folder" and real(place) == real(out):
        raise InputError(
            f"{out}: is searched for takes itself; write into a folder of its own, "
            "which may lie in it"
        )
    return kind == "folder"


def _in_folder(place: str, out: str) -> list[Source]:
    store, root = store_at(place), real(place)
    # What is written is not searched, if it lies in what is.
    written = f"{real(out)}/".removeprefix(f"{root}/")
    return [
        Source(file.name, store, f"{root}/{file.name}", file, named=False)
        for file in _candidates(store)
        if not file.name.startswith(written)
    ]


def _candidates(store: Store) -> Iterator[Found]:
    for file in store.files():
        if PurePosixPath(file.name.lower().removesuffix(".gz")).suffix in _TAKES:
            yield file


def _alone(place: str) -> list[Source]:
    """Return a file that the user named, whatever its extension."""
    path = place if is_url(place) else str(Path(place).absolute())
    folder, _, name = path.rpartition("/")
    store = store_at(folder or "/")
    file = store.found(name)
    if file is None:
        raise InputError(f"{place}: there is no such file; check the name")
    return [Source(name, store, real(place), file, named=True)]


def _label(place: str, found: Sequence[Source], names: Counter[str]) -> str:
    """Return what comes in front of a folder's takes: its name, and perhaps a number.

    Args:
        place: The input.
        found: What is in it.
        names: How often each name has been given.
    """
    if len(found) == 1 and found[0].named:
        return ""
    name = PurePosixPath(place).name
    if name in ("", ".."):
        name = PurePosixPath(real(place)).name
    names[name] += 1
    return name if names[name] == 1 else f"{name}-{names[name]}"


def _labeled(source: Source, label: str) -> Source:
    return replace(source, take=f"{label}/{source.take}") if label else source


def _apart(sources: Sequence[Source]) -> list[Source]:
    names = apart(source.take for source in sources)
    return [
        replace(source, take=name) for source, name in zip(sources, names, strict=True)
    ]
