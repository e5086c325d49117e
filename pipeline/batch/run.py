"""Cleaning many takes, each only once, even if runs are interrupted."""

import logging
import os
from collections import deque
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from threading import TIMEOUT_MAX, Lock, Thread, Timer
from time import perf_counter
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.formats.files import local_path
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import ProcessDiedError, Workers, cores, one_thread

from .manifest import Manifest, Row, open_manifest, write_csv
from .plan import Job, find_sources, plan_jobs
from .store import remove_unfinished, store_at
from .task import clean_file, why_no_take

_MAX_SCHEDULED = 1000  # jobs submitted to the scheduler at a time
_CONNECT_TIMEOUT = "10s"  # for the scheduler to answer
_CLOSE_TIMEOUT = "2s"  # for closing the connection
_POLL = 1.0  # s between checks for workers and for a Ctrl-C that did not interrupt
_REPORT_DELAY = 2.0  # s for the row of a hanging take to reach the scheduler; a guess

_one_at_a_time = Lock()
_DIED = (
    "its process died twice, perhaps for lack of memory; try 'kinefilter clean' on it"
)


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
    """Return local processes or a Dask scheduler's workers; InputError without them."""
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
            # Dask raises this if a worker dies while its row arrives.
            if str(error) == f"cannot unpack non-iterable {Row.__name__} object":
                return None
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


@dataclass
class Outcome:
    """Result of a batch, so far while it runs."""

    kept: list[Row] = field(default_factory=list)  # up to date from earlier runs
    rows: list[Row] = field(default_factory=list)  # from this run
    seconds: float = 0.0  # spent cleaning
    earlier: int = 0  # takes in the manifest that were not given this time
    takes: int = 0  # takes to clean
    size: int = 0  # their approximate size [bytes]
    size_done: int = 0  # that of those cleaned or failed [bytes]
    idle: bool = False  # True while there are no workers

    def __post_init__(self) -> None:
        self.failed = [row for row in self.rows if row.status == "failed"]

    @property
    def damaged(self) -> list[Row]:
        """Rows of damaged takes, including those from earlier runs."""
        rows = [*self.kept, *self.rows]
        return [row for row in rows if any(c.failures or c.damage for c in row.clips)]


OnProgress = Callable[[Outcome], None]


def clean_files(
    inputs: Sequence[str],
    out: str,
    settings: Settings | None = None,
    *,
    suffix: str = ".usdc",
    given: Collection[str] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    take_timeout: float | None = None,
    on_progress: OnProgress = lambda _: None,
) -> Outcome:
    """Clean takes into a folder with the same tree; resume if a run was interrupted.

    ``manifest.jsonl`` in ``out``, at a URL ``manifest/*.jsonl``, gets a line for each
    take once its clip is written; the table ``manifest.csv`` is written at the end.
    After a KeyboardInterrupt, both are up to date.

    ``inputs`` are takes and folders to search for takes; these and ``out`` may be URLs.
    ``suffix`` is the extension of the clips; ``plan_jobs`` describes ``settings`` and
    ``given``, and the command ``Batch`` the rest. ``on_progress`` is called at the
    start, after every take, and while there are no workers.

    Raises InputError if the request is impossible, no file is a take, or the manifest
    cannot be written. A faulty take raises nothing; its row in the outcome has the
    error.
    """
    inputs, out = [*map(local_path, inputs)], local_path(out)
    if out.startswith("memory:"):
        raise InputError(f"{out}: clips there would be lost; name a folder")
    store = store_at(out)
    sources = find_sources(inputs, out)
    settings = settings or Settings()
    planned = plan_jobs(
        sources, store, settings, suffix, given=given, take_timeout=take_timeout
    )
    with one_thread(), ExitStack() as cleanup:  # all steps, even if one is interrupted
        # Opened first, so that nothing is written if no scheduler answers.
        crew = open_crew(scheduler, jobs or cores())
        cleanup.callback(crew.end)
        manifest = cleanup.enter_context(open_manifest(store))
        written = {file.name: file for file in store.files()} if manifest.rows else {}
        given_now = {job.take for job in planned}
        others = (r for r in manifest.rows.values() if r.status != "no take")
        outcome = Outcome(earlier=sum(row.take not in given_now for row in others))
        todo = []
        for job in planned:
            row = manifest.rows.get(job.take)
            if row is not None and job.is_done(row, written):
                outcome.kept.append(row)
            else:
                todo.append(job)

        def write_table(error: object, *_: object) -> None:
            # After another error, an unwritable table is not worth reporting.
            with suppress(InputError) if error else nullcontext():
                write_csv(manifest.rows.values(), store)

        cleanup.push(write_table)
        cleanup.callback(remove_unfinished, store)
        cleanup.callback(crew.end)
        remove_unfinished(store)
        _clean(todo, crew, manifest, outcome, on_progress)
    if all(row.status == "no take" for row in (*outcome.kept, *outcome.rows)):
        first = min(planned, key=lambda job: job.take)
        raise InputError(
            f"{', '.join(inputs)}: no take among {counted(len(planned), 'file')}; "
            f"{why_no_take(first)}"
        )
    return outcome


def _clean(
    jobs: Sequence[Job],
    crew: Crew,
    manifest: Manifest,
    outcome: Outcome,
    on_progress: OnProgress,
) -> None:
    outcome.takes, outcome.size = len(jobs), sum(job.size for job in jobs)
    start = perf_counter()

    def record(done: Sequence[tuple[Job, Row]]) -> None:
        rows = manifest.append([row for _, row in done])
        outcome.rows += rows
        outcome.failed += [row for row in rows if row.status == "failed"]
        outcome.seconds = perf_counter() - start
        outcome.size_done += sum(job.size for job, _ in done)
        outcome.idle = not rows and crew.is_idle()
        on_progress(outcome)

    died = list(jobs)
    # A job whose process died is retried, with no other job running.
    for at_once in (crew.room, 1):
        waiting, died, running = deque(died), [], 0
        done: list[tuple[Job, Row]] = []
        try:
            while waiting or running:
                while waiting and running < at_once:
                    crew.submit(waiting.popleft())
                    running += 1
                record(done)  # after submitting, so that no worker waits for it
                done = []
                finished = crew.finished()
                running -= len(finished)
                done = [(job, row) for job, row in finished if row is not None]
                died += [job for job, row in finished if row is None]
        finally:
            if done:
                record(done)
    for job in died:
        record([(job, job.row("failed", error=_DIED))])
