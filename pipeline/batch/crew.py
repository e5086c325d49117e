"""Workers that clean takes: local processes, or those of a Dask cluster."""

import logging
import os
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from threading import TIMEOUT_MAX, Lock, Thread, Timer
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.workers import ProcessDiedError, Workers

from .manifest import Row
from .plan import Job
from .task import clean_file

_MAX_SCHEDULED = 1000  # jobs submitted to the scheduler at a time
_CONNECT_TIMEOUT = "10s"  # for the scheduler to answer
_CLOSE_TIMEOUT = "2s"  # for closing the connection
_POLL = 1.0  # s between checks for workers and for a Ctrl-C that did not interrupt
_REPORT_DELAY = 2.0  # s for the row of a hanging take to reach the scheduler; a guess

_one_at_a_time = Lock()


class Crew:
    """Local processes, each of which does one job at a time."""

    def __init__(self, room: int, pool: Any) -> None:
        self.room, self._pool = room, pool  # maximum number of jobs at a time
        self._running: dict[Future[Row], Job] = {}
        self._done = SimpleQueue[Future[Row]]()

    def is_idle(self) -> bool:
        """Return True if there are no workers."""
        return False

    def submit(self, job: Job) -> None:
        """Start a job."""
        future = self._start(job)
        self._running[future] = job
        future.add_done_callback(self._done.put)

    def finished(self) -> list[tuple[Job, Row | None]]:
        """Wait for jobs; return finished ones with their row, or None if a worker died.

        May return nothing after a second, so that the caller can check for workers.
        """
        done = []
        with suppress(Empty):
            done.append(self._done.get(timeout=_POLL))
            while True:
                done.append(self._done.get_nowait())
        jobs = [(future, self._running.pop(future)) for future in done]
        return [(job, self._row(future, job)) for future, job in jobs]

    def end(self) -> None:
        """End the workers within seconds, even busy ones; may be called repeatedly."""
        self._pool.end()

    def _start(self, job: Job) -> Future[Row]:
        started: Future[Row]
        started = self._pool.submit_within(job.limit, partial(clean_file, job))
        return started

    def _row(self, done: Future[Row], job: Job) -> Row | None:
        try:
            return done.result()
        except TimeoutError:
            return _overdue(job)
        except ProcessDiedError:
            return None


def open_crew(scheduler: str | None, jobs: int) -> Crew:
    """Return the workers of a Dask scheduler, or ``jobs`` local processes.

    Raises InputError if the scheduler does not answer, or Dask is not installed.
    """
    return Crew(jobs, Workers(jobs)) if scheduler is None else _Cluster(scheduler)


class _Cluster(Crew):
    """The workers of a Dask scheduler.

    A job whose worker dies is retried by another worker, as often as the cluster's
    setting ``distributed.scheduler.allowed-failures`` allows.
    """

    def __init__(self, address: str) -> None:
        require("distributed", "--scheduler", "cluster")
        import distributed

        # ``_row`` reports a lost scheduler in one line; Dask would log many.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            client: Any = distributed.Client
            self._client = client(address, timeout=_CONNECT_TIMEOUT)
        except (OSError, ValueError) as error:
            wrong = f"no scheduler answers ({error}); start one with 'dask scheduler'"
            raise InputError(f"--scheduler {address}: {wrong}") from None
        super().__init__(_MAX_SCHEDULED, self._client.get_executor(pure=False))

    def end(self) -> None:
        running, self._running = self._running, {}
        for future in running:
            future.cancel()
        self._client.close(_CLOSE_TIMEOUT)

    def is_idle(self) -> bool:
        try:
            return not self._client.nthreads()
        except OSError:  # the scheduler is gone, which ``_row`` reports
            return False

    def _start(self, job: Job) -> Future[Row]:
        started: Future[Row] = self._pool.submit(_clean_in_time, clean_file, job)
        return started

    def _row(self, done: Future[Row], job: Job) -> Row | None:
        from distributed.scheduler import KilledWorker

        try:
            return done.result()
        except CancelledError:
            hint = "restart it, and run the same command again to resume"
            raise InputError(f"the cluster is gone; {hint}") from None
        except KilledWorker:
            return None
        except Exception as error:  # e.g. a worker with another version of kinefilter
            return job.row("failed", error=f"no worker could clean it ({error})")


def _clean_in_time(clean: Callable[[Job], Row], job: Job) -> Row:
    """Clean a take on a Dask worker; end the worker if the take exceeds its limit.

    A hanging thread cannot be stopped without its process. The worker's nanny, if it
    has one, starts a new worker.
    """
    from distributed import get_worker

    worker, rows = get_worker(), list[Row]()
    # Dask may run several tasks in threads, but correctors hold the state of one take.
    _one_at_a_time.acquire()
    thread = Thread(target=lambda: rows.append(clean(job)), daemon=True)
    thread.start()
    thread.join(min(job.limit, TIMEOUT_MAX))
    if thread.is_alive():  # keep the lock: nothing else may start here
        rows.append(_overdue(job))
        end: Callable[[], object] = partial(worker.loop.add_callback, worker.close)
        Timer(_REPORT_DELAY, partial(os._exit, 1) if worker.nanny else end).start()
    else:
        _one_at_a_time.release()
    return rows[0]


def _overdue(job: Job) -> Row:
    error = f"not finished after {job.limit:.6g} s; allow more with --take-timeout"
    return job.row("failed", seconds=job.limit, error=error)
