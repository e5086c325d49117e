"""Who does the jobs: processes of this machine, or the workers of a Dask cluster.

Workers of a cluster may come and go. Whoever reaches a Dask scheduler can run code on
its workers: keep it in a network of your own.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.workers import workers

from .manifest import Row
from .plan import Job
from .task import clean_file

_SCHEDULED = 1000  # jobs that the scheduler has at a time, for workers without one
_CONNECTED_IN = "10s"  # in which the scheduler has to answer
_LOOK = 2.0  # s between looks at whether there are workers


class Crew(AbstractContextManager["Crew"]):
    """Who does the jobs; a context that ends them."""

    room: int  # how many jobs they take at once

    def is_idle(self) -> bool:
        """Tell whether there are no workers."""
        return False

    @abstractmethod
    def submit(self, job: Job) -> None:
        """Give them a job."""

    @abstractmethod
    def finished(self) -> list[tuple[Job, Row | None]]:
        """Wait for jobs; return those done. None: its process died.

        Without workers it does not wait for long.
        """


def open_crew(scheduler: str | None, jobs: int) -> Crew:
    """Return the workers of a Dask scheduler, or processes of this machine.

    Raises InputError if no scheduler answers there, or Dask is not installed.
    """
    return _Processes(jobs) if scheduler is None else _Cluster(scheduler)


class _Processes(Crew):
    """Pools of one process each, which tells whose job killed it."""

    def __init__(self, count: int) -> None:
        self.room = count
        self._running: dict[Future[Row], tuple[Job, ProcessPoolExecutor]] = {}
        self._pools: dict[ProcessPoolExecutor, ExitStack] = {}
        self._resting: list[ProcessPoolExecutor] = []

    def __exit__(self, *error: Any) -> None:
        with ThreadPoolExecutor(max(1, len(self._pools))) as ending:
            # All at once: each finishes its take, or gives it up after an error.
            for pool in self._pools.values():
                ending.submit(pool.__exit__, *error)

    def submit(self, job: Job) -> None:
        if not self._resting:
            stack = ExitStack()
            self._resting.append(stack.enter_context(workers(1)))
            self._pools[self._resting[-1]] = stack
        pool = self._resting.pop()
        self._running[pool.submit(clean_file, job)] = job, pool

    def finished(self) -> list[tuple[Job, Row | None]]:
        results = []
        for future in wait(self._running, return_when=FIRST_COMPLETED).done:
            job, pool = self._running.pop(future)
            row = _row_of(future, job, BrokenProcessPool)
            if row is None:
                self._pools.pop(pool).close()
            else:
                self._resting.append(pool)
            results.append((job, row))
        return results


class _Cluster(Crew):
    """The workers of a Dask scheduler.

    A job whose worker dies goes to another, as often as the cluster's setting
    ``distributed.scheduler.allowed-failures`` allows.
    """

    room = _SCHEDULED

    def __init__(self, address: str) -> None:
        require("distributed", "--scheduler", "cluster")
        import distributed

        # Its log of a scheduler that goes away is one line of ours, see ``_row_of``.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            client: Any = distributed.Client
            self._client = client(address, timeout=_CONNECTED_IN)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {address}: nobody answers ({error}); start one with "
                "'dask scheduler'"
            ) from None
        self._pool = self._client.get_executor(pure=False)
        self._running: dict[Future[Row], Job] = {}

    def __exit__(self, *_: object) -> None:
        for future in self._running:
            future.cancel()
        self._client.close()

    def is_idle(self) -> bool:
        try:
            return not self._client.nthreads()
        except OSError:  # the scheduler is gone, as its jobs will tell
            return False

    def submit(self, job: Job) -> None:
        self._running[self._pool.submit(clean_file, job)] = job

    def finished(self) -> list[tuple[Job, Row | None]]:
        from distributed.scheduler import KilledWorker

        done = wait(self._running, _LOOK, return_when=FIRST_COMPLETED).done
        jobs = [(future, self._running.pop(future)) for future in done]
        return [(job, _row_of(future, job, KilledWorker)) for future, job in jobs]


def _row_of(future: Future[Row], job: Job, death: type[BaseException]) -> Row | None:
    """Return the row of a job that is done; None if it raised that its process died."""
    try:
        return future.result()
    except CancelledError:
        raise InputError(
            "the cluster is gone; start it again, and the same command goes on"
        ) from None
    except death:
        return None
    except Exception as error:  # such as a worker that has another kinefilter
        return job.row("failed", error=f"no worker could clean it ({error})")
