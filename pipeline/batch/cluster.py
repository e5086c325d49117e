"""The workers of a Dask cluster, which may come and go.

Whoever reaches a Dask scheduler can run code on its workers: keep it in a network of
your own.
"""

from __future__ import annotations

import logging
from concurrent.futures import FIRST_COMPLETED, Future, wait
from types import TracebackType
from typing import Any, Self

from kinefilter.characters import InputError
from kinefilter.pipeline.extras import require

from .crew import finished_row
from .plan import Job
from .row import Row
from .task import clean_file

_ROOM = 1000
"""Jobs that the scheduler has at a time: it gives them to who has none."""
_PATIENCE = "10s"  # for the scheduler to answer
_LOOK = 2.0  # s between looks at who is there


class Cluster:
    """The workers of a scheduler.

    A job whose worker dies goes to another, as often as the cluster's setting
    ``distributed.scheduler.allowed-failures`` allows.
    """

    def __init__(self, address: str) -> None:
        """Find the scheduler.

        Raises:
            InputError: Nobody answers there, or Dask is not installed.
        """
        require("distributed", "--scheduler", "cluster")
        import distributed

        # What it logs when a scheduler goes is told in a line, see ``finished_row``.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self.room = _ROOM
        try:
            client: Any = distributed.Client
            self._client = client(address, timeout=_PATIENCE)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {address}: nobody answers ({error}); start one with "
                "'dask scheduler'"
            ) from None
        self._pool = self._client.get_executor(pure=False)
        self._running: dict[Future[Row], Job] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for future in self._running:
            future.cancel()
        self._client.close()

    @property
    def idle(self) -> bool:
        """Whether the scheduler has no workers."""
        try:
            return not self._client.nthreads()
        except OSError:  # the scheduler has gone, as its jobs will say
            return False

    def submit(self, job: Job) -> None:
        """Give the scheduler a job."""
        self._running[self._pool.submit(clean_file, job)] = job

    def finished(self) -> list[tuple[Job, Row | None]]:
        """Wait for jobs, but not for ever; return those done."""
        from distributed.scheduler import KilledWorker

        done = wait(self._running, _LOOK, return_when=FIRST_COMPLETED).done
        return [
            (job, finished_row(future, job, (KilledWorker,)))
            for future in done
            for job in [self._running.pop(future)]
        ]
