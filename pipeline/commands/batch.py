"""``kinefilter batch``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.formats.export import Export
from kinefilter.pipeline.settings import Settings

from .terminal import err, out, progress_display

if TYPE_CHECKING:
    from kinefilter.pipeline.batch import JobProgress
    from kinefilter.pipeline.batch.run import OnProgress


@dataclass(frozen=True)
class Batch:
    """Clean all takes of folders; the same command again goes on where it ended.

    Files that are not takes are skipped. OUT/manifest.jsonl (at a URL:
    OUT/manifest/*.jsonl) has a line for each take that is finished, OUT/manifest.csv is
    a table of them. A take is cleaned again if it failed, if its clip is missing, or if
    anything changed: the take, its clip, the options, a database or model, or
    kinefilter's version. A file kinefilter.toml in a folder of takes holds options for
    them and for the folders in it, such as cutoff = 4.0 or rotation-order = "xyz";
    options on the command line override it.

    URLs are those that fsspec knows, such as s3://bucket/takes with pip install s3fs;
    run one batch at a time into a store, which cannot be locked. For --scheduler every
    worker needs pip install "kinefilter[cluster]"; workers may come and go. Start them
    with dask scheduler --host 127.0.0.1, then dask worker tcp://127.0.0.1:8786
    --nworkers 2 --nthreads 1. Keep the scheduler in a network of your own: whoever
    reaches it can run code.
    """

    inputs: Positional[tuple[str, ...]]
    """Takes, and folders to search for takes; paths, or URLs such as
    s3://bucket/takes."""
    out: Annotated[str, arg(aliases=["-o"])]
    """Folder to write to, a path or URL: the tree of the takes, and the manifest."""
    to: Literal["usdc", "usda", "usd", "usdz", "bvh", "csv", "npz"] = "usdc"
    """Format of the clips."""
    jobs: int | None = None
    """Number of processes; default: one per core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers clean instead; they
    must reach the same paths and URLs."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file of options for all takes; kinefilter.toml in a folder overrides it."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    export: OmitArgPrefixes[Export] = field(default_factory=Export)
    format: TakeFormat | None = None
    """Layout of the takes; default: detected from the content of each."""
    body: int | Literal["all"] | None = None
    """Which person, counted from 1 in order of appearance, or all: a clip each;
    default: the person seen in most frames."""
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the takes, and print what became of them."""
        from kinefilter.pipeline.batch import as_tables, clean_files

        self._check()
        try:
            with _bar(self.scheduler) as show:
                outcome = clean_files(
                    self.inputs,
                    self.out,
                    Settings(self.config, self.export, self.format, self.body),
                    suffix=f".{self.to}",
                    config_file=self.config_file,
                    given=self.given,
                    jobs=self.jobs,
                    scheduler=self.scheduler,
                    on_progress=show,
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
            raise InputError(
                "--jobs is for processes of this machine; leave out --jobs or "
                "--scheduler"
            )


@contextmanager
def _bar(scheduler: str | None) -> Iterator[OnProgress]:
    """Yield what shows how many takes are done, and when all will be."""
    told = False
    with progress_display(counted=False) as bars:
        task = bars.add_task("clean", visible=False)

        def show(progress: JobProgress) -> None:
            nonlocal told
            if progress.idle and not told:
                err.print(
                    f"no worker yet; start one: dask worker {scheduler} --nthreads 1"
                )
                told = True
            words = f"clean {progress.takes_done}/{progress.takes}"
            if progress.failed:
                words += f", {progress.failed} failed"
            bars.update(
                task,
                description=words,
                completed=progress.size_done,
                total=progress.size,
                visible=True,
            )

        yield show
