"""How long work reports its progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")

Progress = Callable[[str, int], Iterable[int]]
"""Called with a stage's name and its number of steps; returns their iterator."""


def silent(stage: str, count: int) -> Iterable[int]:
    """Return the steps of a stage, and report nothing."""
    del stage
    return range(count)


def over(items: Sequence[T], stage: str, progress: Progress) -> Iterator[T]:
    """Yield items, and report how many are done."""
    for k in progress(stage, len(items)):
        yield items[k]
