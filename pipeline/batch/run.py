"""Many takes into clips: each is cleaned once, whatever interrupts the run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

from kinefilter.characters import InputError
from kinefilter.pipeline.config_files import read_settings
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import cores, one_thread

from .crew import Crew, open_crew
from .manifest import Manifest, Row, open_manifest, write_csv
from .plan import Job, find_sources, plan_jobs
from .store import remove_unfinished, store_at

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

    @property
    def damaged(self) -> list[Row]:
        """Rows of takes in which something was wrong, also of earlier runs."""
        rows = [*self.kept, *self.rows]
        return [row for row in rows if any(c.failures or c.damage for c in row.clips)]


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
    take_timeout: float | None = None,
    on_progress: OnProgress = lambda _: None,
) -> Outcome:
    """Clean takes into a folder that mirrors theirs; go on where a run ended.

    ``manifest.jsonl`` in the folder has a line for every take as soon as its clip is
    there, at a URL ``manifest/*.jsonl``; ``manifest.csv`` is the table of them, written
    at the end.

    Takes, folders to search for them, and the folder for the clips are paths or URLs;
    ``suffix`` is the extension of the clips. Settings in ``config_file`` (TOML)
    override ``settings``, those of ``kinefilter.toml`` in the takes' folders override
    both; no file may change those ``given``, by name. By ``sessions`` among them takes
    of several sensors become one clip, see ``find_sessions``. ``jobs`` is the number of
    processes, by default one a core; the workers of a Dask ``scheduler`` clean instead.
    A take that needs more than ``take_timeout`` seconds fails, by default more than an
    hour and a minute for each of its megabytes.
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
        sources,
        store,
        settings or Settings(),
        suffix,
        files=files,
        given=given,
        take_timeout=take_timeout,
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
            row = manifest.rows.get(job.take)
            if row is not None and job.is_done(row, written):
                outcome.kept.append(row)
            else:
                todo.append(job)

        def write_table(error: object, *_: object) -> None:
            with suppress(*[InputError] * (error is not None)):
                write_csv(manifest.rows.values(), store)

        with ExitStack() as ending:  # does each, even if Ctrl-C ends the one before
            ending.push(write_table)
            ending.callback(remove_unfinished, store)
            ending.callback(crew.end)
            remove_unfinished(store)
            _clean(todo, crew, manifest, outcome, on_progress)
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
        rows = manifest.append([row for _, row in done])
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
        try:
            while waiting or running:
                while waiting and running < at_once:
                    crew.submit(waiting.popleft())
                    running += 1
                note(done)  # only now that free workers have their next job
                done = []
                finished = crew.finished()
                running -= len(finished)
                done = [(job, row) for job, row in finished if row is not None]
                died += [job for job, row in finished if row is None]
        finally:
            if done:
                note(done)
    for job in died:
        note([(job, job.row("failed", error=_DIED))])
