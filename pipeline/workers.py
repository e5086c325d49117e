"""Processes side by side, and how many threads each may use."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

__all__ = ["one_thread", "workers"]

_ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


@contextmanager
def one_thread() -> Iterator[None]:
    """Give linear algebra one thread, in this process and in those begun inside.

    Over matrices this small several threads only fight: on two busy cores training is
    eight times as fast with one.
    """
    # The environment is for libraries loaded later, and for new processes.
    with _environment(_ONE_THREAD), threadpool_limits(1):
        yield


@contextmanager
def workers(
    count: int | None = None, *, environment: Mapping[str, str] | None = None
) -> Iterator[ProcessPoolExecutor]:
    """Yield processes to work in, each with one thread of linear algebra.

    Args:
        count: How many; by default one a core that this process may use.
        environment: Variables that the processes see beside this one's.
    """
    count = count or len(os.sched_getaffinity(0))
    # Not forked: threads of the engine and of linear algebra do not survive it.
    context = multiprocessing.get_context("spawn")
    with one_thread(), _environment(environment or {}):
        pool = ProcessPoolExecutor(count, mp_context=context, initializer=_ignore)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _ignore() -> None:
    """Leave Ctrl-C, which reaches every process, to the one that waits for them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
