"""Cleaning many takes, each only once, even if runs are interrupted."""

from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, field
from time import perf_counter

from kinefilter.characters import InputError
from kinefilter.pipeline.formats.files import local_path
from kinefilter.pipeline.settings import Settings
from kinefilter.pipeline.workers import cores, one_thread

from .crew import Crew, open_crew
from .manifest import Manifest, Row, open_manifest, write_csv
from .plan import Job, find_sources, plan_jobs
from .store import remove_unfinished, store_at

_DIED = (
    "its process died twice, perhaps for lack of memory; try 'kinefilter clean' on it"
)


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

    Raises InputError if the request is impossible or the manifest cannot be written. A
    faulty take raises nothing; its row in the outcome has the error.
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
