"""Many takes into clips: each is cleaned once, whatever interrupts the run.

Processes of this machine do the jobs, or the workers of a Dask cluster, which may come
and go. Whoever reaches a Dask scheduler can run code on its workers: keep it in a
network of your own.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from kinefilter.characters import InputError
from kinefilter.pipeline.config_files import read_settings
from kinefilter.pipeline.extras import require
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import cores, one_thread, workers

from .manifest import Manifest, Row, open_manifest, write_csv
from .plan import Job, find_sources, plan_jobs
from .store import remove_unfinished, store_at
from .task import clean_file

_SCHEDULED = 1000  # jobs that the scheduler has at a time, for workers without one
_CONNECTED_IN = "10s"  # in which the scheduler has to answer
_LOOK = 2.0  # s between looks at whether there are workers
_DIED = "its process died twice; is memory short? 'kinefilter clean' may tell more"


@dataclass
class JobProgress:
    """How far a batch is."""

    takes: int  # to clean
    size: int  # of these, about [bytes]
    takes_done: int = 0  # that were cleaned, or failed
    size_done: int = 0  # of these [bytes]
    failed: int = 0  # takes
    idle: bool = False  # there are no workers


@dataclass
class Outcome:
    """What became of the takes."""

    kept: list[Row] = field(default_factory=list)  # of an earlier run: nothing to do
    rows: list[Row] = field(default_factory=list)  # of this run
    seconds: float = 0.0  # spent cleaning

    @property
    def failed(self) -> list[Row]:
        """Rows of takes that failed."""
        return [row for row in self.rows if row.status == "failed"]


OnProgress = Callable[[JobProgress], None]


def clean_files(
    inputs: Sequence[str],
    out: str,
    settings: Settings | None = None,
    *,
    suffix: str = ".usdc",
    config_file: Path | None = None,
    given: Collection[str] = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    on_progress: OnProgress = lambda _: None,
) -> Outcome:
    """Clean takes into a folder that mirrors theirs; go on where a run ended.

    ``manifest.jsonl`` in the folder has a line for every take as soon as its clip is
    there, at a URL ``manifest/*.jsonl``; ``manifest.csv`` is the table of them, written
    at the end.

    Takes, folders to search for them, and the folder for the clips are paths or URLs;
    ``suffix`` is the extension of the clips. Settings in ``config_file`` (TOML)
    override ``settings``, those of ``kinefilter.toml`` in the takes' folders override
    both; no file may change those ``given``, by name. ``jobs`` is the number of
    processes, by default one a core; the workers of a Dask ``scheduler`` clean instead.
    ``on_progress`` is called at the start, after every take, and while there are no
    workers.

    Raises InputError if the request is impossible, or the manifest cannot be written; a
    take that is wrong raises nothing: its row says so. After a KeyboardInterrupt the
    manifest is up to date.
    """
    store = store_at(out)
    files = [] if config_file is None else [read_settings(config_file)]
    sources = find_sources(inputs, out)
    planned = plan_jobs(
        sources, store, settings or Settings(), suffix, files=files, given=given
    )
    with (
        one_thread(),
        # First, so that nothing is written where no scheduler answers.
        open_crew(scheduler, jobs or cores()) as crew,
        open_manifest(store) as manifest,
    ):
        written = {file.name: file for file in store.files()} if manifest.rows else {}
        outcome, todo = Outcome(), []
        for job in planned:
            row = manifest.rows.get(job.source.take)
            if row is not None and job.is_done(row, written):
                outcome.kept.append(row)
            else:
                todo.append(job)
        try:
            remove_unfinished(store)
            _clean(todo, crew, manifest, outcome, on_progress)
            remove_unfinished(store)
        except BaseException:
            with suppress(InputError):
                write_csv(manifest.rows.values(), store)
            raise
        write_csv(manifest.rows.values(), store)
    return outcome


def _clean(
    jobs: Sequence[Job],
    crew: Crew,
    manifest: Manifest,
    outcome: Outcome,
    on_progress: OnProgress,
) -> None:
    """Do jobs, and keep manifest and outcome up to date."""
    progress = JobProgress(len(jobs), sum(job.size for job in jobs))
    start = perf_counter()

    def note(done: Sequence[tuple[Job, Row]]) -> None:
        """Note rows as they come, or none while there are no workers."""
        rows = [row for _, row in done]
        if rows:
            manifest.append(rows)
        outcome.rows += rows
        outcome.seconds = perf_counter() - start
        progress.takes_done += len(done)
        progress.size_done += sum(job.size for job, _ in done)
        progress.failed += sum(row.status == "failed" for row in rows)
        progress.idle = not rows and crew.is_idle()
        on_progress(progress)

    died = list(jobs)
    # A job whose process died is tried again, with no other job running.
    for at_once in (crew.room, 1):
        waiting, died, running = deque(died), [], 0
        done: list[tuple[Job, Row]] = []
        while waiting or running:
            while waiting and running < at_once:
                crew.submit(waiting.popleft())
                running += 1
            note(done)  # only now that free workers have their next job
            finished = crew.finished()
            running -= len(finished)
            done = [(job, row) for job, row in finished if row is not None]
            died += [job for job, row in finished if row is None]
        if done:
            note(done)
    for job in died:
        note([(job, job.row("failed", error=_DIED))])


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
