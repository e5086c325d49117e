"""Processes side by side."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

__all__ = ["cores", "workers"]

_ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def workers(
    count: int | None = None, *, environment: Mapping[str, str] | None = None
) -> Iterator[ProcessPoolExecutor]:
    """Yield processes to work in, each with one thread of linear algebra.

    Several threads a process would fight for the same cores.

    Args:
        count: How many; by default one a core that this process may use.
        environment: Variables that the processes see beside this one's.
    """
    count = count or cores()
    seen = {**_ONE_THREAD, **(environment or {})}
    before = {name: os.environ.get(name) for name in seen}
    os.environ.update(seen)
    try:
        # Not forked: threads of the engine and of linear algebra do not survive it.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, mp_context=context, initializer=_ignore)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _ignore() -> None:
    """Leave Ctrl-C, which reaches every process, to the one that waits for them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
