"""Many takes at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from kinefilter.characters import Take

from .config import CleanConfig
from .run import CleanResult, clean

__all__ = ["clean_takes"]


def clean_takes(
    takes: Sequence[Take],
    config: CleanConfig | None = None,
    *,
    pool: ProcessPoolExecutor,
) -> Iterator[CleanResult]:
    """Clean takes side by side; results come in the order of the takes.

    Args:
        takes: The recordings.
        config: What to do with each.
        pool: Where; see ``workers``.

    Raises:
        InputError: As ``clean``, for the first take that is wrong.
    """
    return pool.map(partial(clean, config=config), takes)
