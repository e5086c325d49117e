"""Progress reports of long computations."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")
Progress = Callable[[str, int], Iterable[int]]
"""Called with the name of a stage and its number of steps; yields the steps."""


def silent(_stage: str, count: int) -> Iterable[int]:
    """Return the steps without reporting them."""
    return range(count)


def over(items: Sequence[T], stage: str, progress: Progress) -> Iterator[T]:
    """Yield items, reporting how many are done."""
    for k in progress(stage, len(items)):
        yield items[k]
