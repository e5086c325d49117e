"""Many takes at once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial

from kinefilter.characters import Take

from .config import CleanConfig
from .run import CleanResult, clean
from .threads import one_thread

__all__ = ["clean_takes", "workers"]


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


@contextmanager
def workers(count: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Yield processes to clean takes in, each with one thread of linear algebra.

    Args:
        count: How many; by default one a core that this process may use.
    """
    count = count or len(os.sched_getaffinity(0))
    # Not forked: threads of the engine and of linear algebra do not survive it.
    context = multiprocessing.get_context("spawn")
    with one_thread(), ProcessPoolExecutor(count, mp_context=context) as pool:
        yield pool
