"""What clips are called: the tree of the takes, with another extension."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import PurePosixPath

_Key = Callable[[str], str]


def clip_names(
    takes: Sequence[str], suffix: str, *, several: bool = False
) -> list[str]:
    """Return the path of each take's clip, no two the same.

    ``walks/fast.csv.gz`` becomes ``walks/fast.usdc``. Takes that differ only in their
    extension keep it: ``fast.csv.usdc`` and ``fast.bvh.usdc``. So a name depends on
    what else there is, but not on its order.

    Args:
        takes: Paths of the takes, no two the same.
        suffix: Extension of the clips, such as ``.usdc``.
        several: Takes may give a clip for each of several people, see ``numbered``.
    """
    key: _Key = _without_number if several else str.casefold
    names, longer = list[str](), [_stem(take) for take in takes]
    while names != longer:
        names, counts = longer, Counter(map(key, longer))
        longer = [
            take if counts[key(name)] > 1 else name
            for take, name in zip(takes, names, strict=True)
        ]
    return [name + suffix for name in apart(names, str.casefold)]


def apart(names: Iterable[str], key: _Key = str) -> list[str]:
    """Return names with a number in front of all but the first of a key."""
    taken: set[str] = set()
    different = []
    for name in names:
        path, free, number = PurePosixPath(name), name, 1
        while key(free) in taken:
            number += 1
            free = str(path.with_name(f"{number}-{path.name}"))
        taken.add(key(free))
        different.append(free)
    return different


def _without_number(name: str) -> str:
    """Return what names have in common that a person's number may make the same."""
    return re.sub(r"(\.\d+)+$", "", name.casefold())


def _stem(take: str) -> str:
    path = PurePosixPath(take)
    if path.suffix.lower() == ".gz":
        path = path.with_suffix("")
    return str(path.with_suffix(""))
