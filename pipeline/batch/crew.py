"""Who does the jobs: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack
from types import TracebackType
from typing import Any, Protocol, Self

from kinefilter.characters import InputError
from kinefilter.pipeline.workers import one_thread, workers

from .plan import Job
from .row import Row
from .task import clean_file


class Crew(Protocol):
    """Who does the jobs; a context that ends them."""

    room: int
    """How many jobs they take at once."""

    @property
    def idle(self) -> bool:
        """Whether nobody is there."""

    def submit(self, job: Job) -> None:
        """Give them a job."""

    def finished(self) -> list[tuple[Job, Row | None]]:
        """Wait for jobs; return those done. None: the process died over it.

        Where nobody is there it does not wait for long.
        """


class _Worker:
    """A process of its own, so that its death shows whose job it was."""

    def __init__(self) -> None:
        self._context: AbstractContextManager[ProcessPoolExecutor] = workers(1)
        self._pool = self._context.__enter__()

    def submit(self, job: Job) -> Future[Row]:
        return self._pool.submit(clean_file, job)

    def end(self, *error: Any) -> None:
        """End the process; with an error it gives up what it is at."""
        self._context.__exit__(*(error or (None, None, None)))


class Processes:
    """Processes of this machine, each with one thread of linear algebra."""

    idle = False

    def __init__(self, count: int) -> None:
        self.room = count
        self._running: dict[Future[Row], tuple[Job, _Worker]] = {}
        self._resting: list[_Worker] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.enter_context(one_thread())
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        crew = [worker for _, worker in self._running.values()] + self._resting
        with self._stack, ThreadPoolExecutor(max(1, len(crew))) as ending:
            # All at once: each finishes or gives up what it is at.
            for worker in crew:
                ending.submit(worker.end, kind, error, trace)

    def submit(self, job: Job) -> None:
        """Give a job to a process that rests, or to a new one."""
        worker = self._resting.pop() if self._resting else _Worker()
        self._running[worker.submit(job)] = job, worker

    def finished(self) -> list[tuple[Job, Row | None]]:
        """Wait for jobs; return those done."""
        done = wait(self._running, return_when=FIRST_COMPLETED).done
        results = []
        for future in done:
            job, worker = self._running.pop(future)
            row = finished_row(future, job, (BrokenProcessPool,))
            if row is None:
                worker.end()
            else:
                self._resting.append(worker)
            results.append((job, row))
        return results


def finished_row(
    future: Future[Row], job: Job, deaths: Sequence[type[BaseException]]
) -> Row | None:
    """Return the row of a job that is done; None where its process died.

    Args:
        future: What is done.
        job: The job.
        deaths: Errors by which a process's death is told.

    Raises:
        InputError: Nobody works any more.
    """
    try:
        return future.result()
    except CancelledError:
        raise InputError(
            "the cluster has gone; start it, and the same command goes on"
        ) from None
    except tuple(deaths):
        return None
    except Exception as error:  # such as a worker that has another kinefilter
        return failed_row(job, f"no worker could do it ({error})")


def failed_row(job: Job, error: str) -> Row:
    """Return the row of a job that nobody could finish."""
    return Row(
        take=job.source.take,
        status="failed",
        output=job.output,
        stamp=job.source.file.stamp,
        sha256="",
        settings=job.fingerprint,
        seconds=0.0,
        error=error,
    )
