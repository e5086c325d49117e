"""``kinefilter batch``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich import progress as rich_progress
from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.formats.export import Export
from kinefilter.pipeline.settings import Settings

from .terminal import err, out

if TYPE_CHECKING:
    from kinefilter.pipeline.batch import Standing
    from kinefilter.pipeline.batch.run import Told
    from kinefilter.pipeline.progress import Progress


@dataclass(frozen=True)
class Batch:
    """Clean all takes of folders; the same command again goes on where it ended.

    What is no take is passed over. OUT/manifest.jsonl (at a URL: OUT/manifest/*.jsonl)
    has a line for each take that is finished, OUT/manifest.csv is a table of them; done
    again is what is missing, has failed, or has changed: the take, its clip, the
    options, a database or model, or kinefilter's version. A file kinefilter.toml in a
    folder of takes holds options for them and for the folders in it, such as cutoff =
    4.0 or rotation-order = "xyz"; options given here are stronger.

    URLs are those that fsspec knows, as s3://bucket/takes with pip install s3fs; only
    one run at a time may write to a store, where nothing locks it. For --scheduler
    every worker needs pip install "kinefilter[cluster]", and may come and go:
    dask scheduler --host 127.0.0.1, then dask worker tcp://127.0.0.1:8786 --nworkers 2
    --nthreads 1. Keep the scheduler in a network of your own: who reaches it can run
    code.
    """

    inputs: Positional[tuple[str, ...]]
    """Takes, and folders that are searched for them; paths, or URLs such as
    s3://bucket/takes."""
    out: Annotated[str, arg(aliases=["-o"])]
    """Folder to write to, a path or URL: the tree of the takes, and the manifest."""
    to: Literal["usdc", "usda", "usd", "usdz", "bvh", "csv", "npz"] = "usdc"
    """Kind of the clips."""
    jobs: int | None = None
    """Processes that clean; default: one a core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers clean instead; they
    see the same paths and URLs."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file of options for all takes; those of a folder's own are stronger."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    export: OmitArgPrefixes[Export] = field(default_factory=Export)
    format: TakeFormat | None = None
    """Layout of the takes; default: detected from the content of each."""
    body: int | Literal["all"] | None = None
    """Which person, counted from 1 as they appear, or all: a clip each; default: who
    is seen in most frames."""
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean, write, tell."""
        from kinefilter.pipeline.batch import as_tables, clean_files

        self._check()
        try:
            with _bars(self.scheduler) as (_, told):
                outcome = clean_files(
                    self.inputs,
                    self.out,
                    Settings(self.config, self.export, self.format, self.body),
                    suffix=f".{self.to}",
                    config_file=self.config_file,
                    given=self.given,
                    jobs=self.jobs,
                    scheduler=self.scheduler,
                    told=told,
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt("the same command again goes on") from None
        out.print(as_tables(outcome))
        return 1 if outcome.failed else 0

    def _check(self) -> None:
        if not self.inputs:
            raise InputError("no takes given; name files or folders of takes")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: expected 1 or more")
        if self.jobs is not None and self.scheduler is not None:
            raise InputError("--jobs are processes here; leave it or --scheduler out")


@contextmanager
def _bars(scheduler: str | None) -> Iterator[tuple[Progress, Told]]:
    """Yield what shows how many takes are done, and when all will be."""
    missing = f"no worker yet; start one: dask worker {scheduler} --nthreads 1"
    columns = (
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.TaskProgressColumn(),
        rich_progress.TimeRemainingColumn(),
    )
    with rich_progress.Progress(
        *columns, console=err, transient=True, disable=not err.is_terminal
    ) as bars:
        task = bars.add_task("clean", visible=False)

        def progress(stage: str, count: int) -> Iterable[int]:
            return bars.track(range(count), count, description=stage)

        def told(standing: Standing) -> None:
            nonlocal missing
            if standing.idle and missing:
                err.print(missing)
                missing = ""
            words = f"clean {standing.takes_done}/{standing.takes}"
            if standing.failed:
                words += f", {standing.failed} failed"
            bars.update(
                task,
                description=words,
                completed=standing.size_done,
                total=standing.size,
                visible=True,
            )

        yield progress, told
