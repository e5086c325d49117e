"""Who cleans the takes: processes of this machine, or the workers of a Dask cluster.

Cluster workers may come and go. Whoever reaches a Dask scheduler can run code on its
workers: keep it in a network of your own.
"""

from __future__ import annotations

import logging
import os
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import wait
from queue import Empty, SimpleQueue
from threading import TIMEOUT_MAX, Lock, Thread, Timer
from time import monotonic
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.workers import Worker, at_most, end_workers

from .manifest import Row
from .plan import Job
from .task import clean_file

_SCHEDULED = 1000  # jobs that the scheduler has at a time, for workers without one
_CONNECTED_IN = "10s"  # in which the scheduler has to answer
_CLOSED_IN = "2s"  # in which it is left
_LOOK = 1.0  # s between looks at whether there are workers, or Ctrl-C came unnoticed
_LOADED_IN = 600.0  # s until a new process has begun its first take; a guess
_REPORTED_IN = 2.0  # s until the scheduler has the row of a take that hangs; a guess

_one_at_a_time = Lock()


class Crew(AbstractContextManager["Crew"]):
    """Who does the jobs; a context that ends them."""

    room: int  # how many jobs they take at once

    def __exit__(self, *_: object) -> None:
        self.end()

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

    @abstractmethod
    def end(self) -> None:
        """End them within seconds, whatever they are doing; may be called again."""


def open_crew(scheduler: str | None, jobs: int) -> Crew:
    """Return the workers of a Dask scheduler, or so many processes of this machine.

    Raises InputError if no scheduler answers there, or Dask is not installed.
    """
    return _Processes(jobs) if scheduler is None else _Cluster(scheduler)


class _Processes(Crew):
    """Processes of this machine, which take one job each."""

    def __init__(self, count: int) -> None:
        self.room = at_most(count)
        self._resting: list[Worker] = []
        self._running: dict[Worker, tuple[Job, float]] = {}  # and when it must be done

    def end(self) -> None:
        end_workers([*self._resting, *self._running])
        self._resting, self._running = [], {}

    def submit(self, job: Job) -> None:
        worker = self._resting.pop() if self._resting else Worker()
        self._running[worker] = job, monotonic() + _LOADED_IN + job.limit
        worker.call(clean_file, job)

    def finished(self) -> list[tuple[Job, Row | None]]:
        results: list[tuple[Job, Row | None]] = []
        while not results:
            first = min(until for _, until in self._running.values())
            ready = wait(
                [worker.calls for worker in self._running],
                min(max(first - monotonic(), 0.0), _LOOK),
            )
            for worker, (job, until) in [*self._running.items()]:
                message = None
                if worker.calls in ready:
                    with suppress(EOFError, OSError):  # it died
                        message = worker.calls.recv()
                elif until > monotonic():
                    continue
                else:
                    message = _overdue(job)
                if message is True:
                    self._running[worker] = job, monotonic() + job.limit
                    continue
                del self._running[worker]
                if worker.calls in ready and message is not None:
                    self._resting.append(worker)
                else:
                    worker.end()
                results.append((job, message))
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
        self._done = SimpleQueue[Future[Row]]()

    def end(self) -> None:
        running, self._running = self._running, {}
        for future in running:
            future.cancel()
        self._client.close(_CLOSED_IN)

    def is_idle(self) -> bool:
        try:
            return not self._client.nthreads()
        except OSError:  # the scheduler is gone, as its jobs will tell
            return False

    def submit(self, job: Job) -> None:
        future = self._pool.submit(_clean_in_time, clean_file, job)
        self._running[future] = job
        future.add_done_callback(self._done.put)

    def finished(self) -> list[tuple[Job, Row | None]]:
        done = []
        with suppress(Empty):
            done.append(self._done.get(timeout=_LOOK))
            while True:
                done.append(self._done.get_nowait())
        jobs = [(future, self._running.pop(future)) for future in done]
        return [(job, _row_of(future, job)) for future, job in jobs]


def _clean_in_time(clean: Callable[[Job], Row], job: Job) -> Row:
    """Clean a take on a cluster's worker; end the worker if the take hangs.

    A thread that hangs cannot be ended alone. The worker's nanny starts another one.
    """
    from distributed import get_worker

    worker, rows = get_worker(), list[Row]()
    # Correction methods hold a take's state; a cluster may run tasks on threads.
    _one_at_a_time.acquire()
    thread = Thread(target=lambda: rows.append(clean(job)), daemon=True)
    thread.start()
    thread.join(min(job.limit, TIMEOUT_MAX))
    if thread.is_alive():  # and nothing else is begun here
        rows.append(_overdue(job))
        end: Callable[[], object] = partial(worker.loop.add_callback, worker.close)
        Timer(_REPORTED_IN, partial(os._exit, 1) if worker.nanny else end).start()
    else:
        _one_at_a_time.release()
    return rows[0]


def _overdue(job: Job) -> Row:
    wrong = f"was given up after {job.limit:.6g} s; give it longer with --take-timeout"
    return job.row("failed", seconds=job.limit, error=wrong)


def _row_of(future: Future[Row], job: Job) -> Row | None:
    """Return the row of a job that a cluster did; None if its workers died."""
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except CancelledError:
        raise InputError(
            "the cluster is gone; start it again, and the same command goes on"
        ) from None
    except KilledWorker:
        return None
    except Exception as error:  # such as a worker that has another kinefilter
        return job.row("failed", error=f"no worker could clean it ({error})")
