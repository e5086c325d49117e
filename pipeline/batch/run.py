"""Many takes into clips: each is done once, whatever happens in between."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

from kinefilter.characters import InputError
from kinefilter.pipeline.config_files import read_settings
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import cores

from .cluster import Cluster
from .crew import Crew, Processes, failed_row
from .local import LocalStore
from .manifest import Manifest, open_manifest, write_csv
from .places import store_at
from .plan import Job, is_done, plan_jobs
from .row import Row
from .sources import find_sources
from .store import Store

_DIED = (
    "the process that cleaned it died, twice; is memory short? 'kinefilter clean' may "
    "tell more"
)


@dataclass
class Standing:
    """How far a run is."""

    takes: int
    """Takes there are to clean."""
    size: int
    """Their size, about [bytes]."""
    takes_done: int = 0
    """Takes that were cleaned, or failed."""
    size_done: int = 0
    """Their size."""
    failed: int = 0
    """Those that failed."""
    idle: bool = False
    """Nobody is there to clean."""


@dataclass
class Outcome:
    """What became of the takes."""

    kept: list[Row] = field(default_factory=list)
    """Rows of an earlier run, of takes that there was nothing to do for."""
    rows: list[Row] = field(default_factory=list)
    """Rows of this run."""
    seconds: float = 0.0
    """How long it took to clean [s]."""

    @property
    def failed(self) -> list[Row]:
        """Rows of takes that failed."""
        return [row for row in self.rows if row.status == "failed"]


Told = Callable[[Standing], None]


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
    told: Told = lambda _: None,
) -> Outcome:
    """Clean takes into a folder that mirrors theirs, and go on where a run ended.

    ``manifest.jsonl`` in the folder has a line for every take as soon as its clip is
    there, at a URL ``manifest/*.jsonl``; ``manifest.csv`` is the table of them, written
    at the end.

    Args:
        inputs: Takes, and folders to search for them; paths or URLs.
        out: Folder for the clips, a path or URL; made if it is missing.
        settings: What is done with each take.
        suffix: Extension of the clips.
        config_file: TOML file of settings, stronger than ``settings``. Those of
            ``kinefilter.toml`` in the takes' folders are stronger still.
        given: Names of settings that no file may change.
        jobs: Processes that clean; by default one a core.
        scheduler: Address of a Dask scheduler whose workers clean instead.
        told: Called at the start, after every take, and while nobody is there.

    Raises:
        InputError: What was asked for is impossible, or the manifest cannot be
            written. A take that is wrong raises nothing: its row says so.
        KeyboardInterrupt: The user had enough; the manifest is as it should be.
    """
    store = store_at(out)
    files = [] if config_file is None else [read_settings(config_file)]
    sources = find_sources(inputs, out)
    planned = plan_jobs(
        sources, store, settings or Settings(), suffix, files=files, given=given
    )
    # The crew first: where nobody answers, nothing is written.
    with _crew(scheduler, jobs or cores()) as crew, open_manifest(store) as manifest:
        outcome, todo = _sifted(planned, manifest, store)
        try:
            _tidy(store)
            _clean(todo, crew, manifest, outcome, told)
            _tidy(store)
        except BaseException:
            with suppress(InputError):
                write_csv(manifest.rows.values(), store)
            raise
        write_csv(manifest.rows.values(), store)
    return outcome


def _sifted(
    planned: Sequence[Job], manifest: Manifest, store: Store
) -> tuple[Outcome, list[Job]]:
    """Return the rows of what is done already, and the jobs that are left."""
    written = {file.name: file for file in store.files()} if manifest.rows else {}
    outcome, todo = Outcome(), []
    for job in planned:
        row = manifest.rows.get(job.source.take)
        if row is not None and is_done(job, row, written):
            outcome.kept.append(row)
        else:
            todo.append(job)
    return outcome, todo


def _tidy(store: Store) -> None:
    """Remove what processes that were killed had begun to write."""
    if isinstance(store, LocalStore):
        store.remove_unfinished()


def _crew(scheduler: str | None, jobs: int) -> Processes | Cluster:
    return Processes(jobs) if scheduler is None else Cluster(scheduler)


def _clean(
    jobs: Sequence[Job], crew: Crew, manifest: Manifest, outcome: Outcome, told: Told
) -> None:
    """Do jobs, and keep manifest and outcome up to date."""
    standing = Standing(len(jobs), sum(job.size for job in jobs))
    start = perf_counter()
    for done in _results(jobs, crew):
        rows = [row for _, row in done]
        if rows:
            manifest.append(rows)
        outcome.rows += rows
        outcome.seconds = perf_counter() - start
        standing.takes_done += len(done)
        standing.size_done += sum(job.size for job, _ in done)
        standing.failed += sum(row.status == "failed" for row in rows)
        standing.idle = not rows and crew.idle
        told(standing)


def _results(
    jobs: Sequence[Job], crew: Crew
) -> Generator[list[tuple[Job, Row]], None, None]:
    """Yield rows as they come, or none while there is nobody to do jobs.

    A job that kills its process is tried again alone.
    """
    killers = yield from _round(jobs, crew, crew.room)
    for job in (yield from _round(killers, crew, 1)):
        yield [(job, failed_row(job, _DIED))]


def _round(
    jobs: Iterable[Job], crew: Crew, at_once: int
) -> Generator[list[tuple[Job, Row]], None, list[Job]]:
    """Yield rows as they come; return the jobs over which a process died."""
    waiting, running = deque(jobs), 0
    rows: list[tuple[Job, Row]] = []
    killers = []
    while waiting or running:
        while waiting and running < at_once:
            crew.submit(waiting.popleft())
            running += 1
        yield rows  # after those were sent to work who had nothing to do
        finished = crew.finished()
        running -= len(finished)
        rows = [(job, row) for job, row in finished if row is not None]
        killers += [job for job, row in finished if row is None]
    if rows:
        yield rows
    return killers
