"""The commands that clean takes: ``clean`` and ``batch``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg

from kinefilter.characters import InputError
from kinefilter.characters.gaps import parts_of
from kinefilter.pipeline.config_files import overlaid, read_settings
from kinefilter.pipeline.formats import (
    Recording,
    check_writable,
    write_clip,
    write_contacts,
    write_people,
)
from kinefilter.pipeline.formats.export import paced
from kinefilter.pipeline.formats.recording import numbered, part_paths
from kinefilter.pipeline.settings import Settings

from .terminal import (
    check_calibration,
    check_output,
    err,
    out,
    progress_bars,
    progress_display,
    write_json,
)

if TYPE_CHECKING:
    from kinefilter.characters import Take
    from kinefilter.pipeline.batch import JobProgress
    from kinefilter.pipeline.batch.run import OnProgress
    from kinefilter.pipeline.cleaner import CleanResult
    from kinefilter.pipeline.merge import Merged


_Settings = OmitArgPrefixes[Annotated[Settings, arg(name="")]]


@dataclass(frozen=True)
class Clean:
    """Clean a Kinect take and write it as an animation clip.

    Takes of the same person by several sensors become one clip; see 'kinefilter merge'.
    """

    takes: Positional[tuple[Path, ...]]
    """Recording in any of the formats of --format, gzipped or not. For several sensors
    give one recording of each; the clip has the clock of the first."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Clip to write; the extension decides: .usda .usdc .usd .usdz .glb
    .vrma .fbx .bvh .csv .npz."""
    settings: _Settings = field(default_factory=Settings)
    save_contacts: Path | None = None
    """Also write a table (CSV) of when each foot is planted, to edit and to pass to
    --contacts."""
    report: Path | None = None
    """Also write a web page (.html) that shows the clip beside the take."""
    json: Path | None = None
    """Also write the printed figures to this file."""
    one_file: bool = False
    """With --body all and .glb: write everybody into one file, each with a skeleton and
    skin, instead of a file each. kinefilter does not read such a file back."""
    fail_on_damage: bool = False
    """End with exit code 1 if the tracker failed somewhere or a take has a long gap."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file of options, such as cutoff = 4.0; the command line overrides it."""
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the take, write the clip, and print its figures."""
        settings = self.settings
        if self.config_file is not None:
            settings = overlaid(settings, [read_settings(self.config_file)], self.given)
        return replace(self, settings=settings)._run()

    def _run(self) -> int:
        from kinefilter.pipeline.summary import as_json

        settings = self.settings
        if not self.takes:
            raise InputError("no take given; name a recording")
        check_calibration(settings.calibration, self.takes)
        used = [*self.takes, self.config_file, *settings.files]
        self._check(used)
        recording = settings.read(self.takes[0])
        several = len(recording.takes) > 1 and settings.body == "all"
        others = (self.json, self.save_contacts, self.report)
        for body in recording.numbers(settings.body):
            number, time = body if several else None, recording.take(body).time
            clip = None if self.one_file else number
            split = settings.config.gaps == "split"
            parts = parts_of(time) if split else [slice(None)]
            paths = part_paths(numbered(self.out, clip), len(parts))
            for path, part in zip(paths, parts, strict=True):
                check_output(path, *used, *others)
                paced(
                    settings.export,
                    self.out.suffix,
                    time[part],
                    recording.takes[0].source,
                )
            for written in others[1:] if several else ():
                if written is not None:
                    check_output(numbered(written, number), *used, self.json)
        merged = None
        if len(self.takes) > 1:
            recording, results, merged = self._together(recording)
        else:
            results = self._cleaned(recording)
        if self.one_file:
            clips = [result.clip for result in results.values()]
            write_people(clips, self.out, settings.export)
        for body, result in results.items():
            number = body if several else None
            paths = [self.out] if self.one_file else self._write_clips(result, number)
            self._write(result, recording.take(body), number, merged, paths)
        figures = {body: as_json(result) for body, result in results.items()}
        only = next(iter(figures.values()))
        write_json({"bodies": figures} if several else only, self.json)
        for note in recording.notes:
            out.print(note)
        count = len(recording.takes)
        if count > 1 and settings.body is None:
            out.print(
                f"body {recording.main + 1} of {count}, seen in most frames; --body 1 "
                f"to {count} cleans another, --body all cleans each"
            )
        damaged = any(result.damage for result in results.values())
        left_out = several and len(results) < count
        return 1 if left_out or (self.fail_on_damage and damaged) else 0

    def _check(self, used: list[Path | None]) -> None:
        """Raise an InputError for files that cannot be written or must be kept."""
        if self.one_file:
            self._check_one_file()
        check_writable(self.out, self.settings.export)
        if self.report is not None:
            from kinefilter.pipeline.look.page import check_report

            check_report(self.report)
        written = (self.out, self.json, self.save_contacts, self.report)
        for k, path in enumerate(written):
            check_output(path, *used, *written[:k])

    def _check_one_file(self) -> None:
        """Raise an InputError for what does not go with a file of several people."""
        settings, export = self.settings, self.settings.export
        alone = {
            "--begin, --end and --loop": export.begin or export.end or export.loop,
            "--gaps split": settings.config.gaps == "split",
        }
        for what, given in alone.items():
            if given:
                raise InputError(f"{what} cut each person's clip; leave --one-file out")
        if settings.body != "all" or self.out.suffix.lower() != ".glb":
            raise InputError("--one-file is for --body all and a clip in .glb")

    def _cleaned(self, recording: Recording) -> dict[int, CleanResult]:
        """Return the result of each person asked for, by their number."""
        from kinefilter.pipeline.cleaner import clean

        config, numbers = self.settings.config, recording.numbers(self.settings.body)
        for name in ("contacts", "edits"):
            if getattr(config, name) is not None and len(numbers) > 1:
                raise InputError(f"--{name} is for one person; choose one with --body")
        results: dict[int, CleanResult] = {}
        for number in numbers:
            take = recording.take(number)
            try:
                with progress_bars() as progress:
                    results[number] = clean(take, config, progress=progress)
            except InputError as error:
                if number == numbers[-1] and not results:
                    raise
                err.print(f"kinefilter: {error}; left out")
        return results

    def _together(
        self, first: Recording
    ) -> tuple[Recording, dict[int, CleanResult], Merged]:
        """Return what several sensors recorded as one, and the result."""
        from kinefilter.pipeline.merge import clean_session, read_calibration

        settings, body = self.settings, self.settings.body
        if body == "all":
            raise InputError(
                "--body all is for one sensor; choose a person of its take"
            )
        others = [settings.read(path) for path in self.takes[1:]]
        with progress_bars() as progress:
            result, merged = clean_session(
                [first, *others],
                settings.config,
                body=body,
                calibration=read_calibration(settings.calibration),
                progress=progress,
            )
        notes = (*first.notes, *merged.told())
        return Recording((merged.take,), "merged", notes=notes), {1: result}, merged

    def _write_clips(self, result: CleanResult, body: int | None) -> list[Path]:
        paths = part_paths(numbered(self.out, body), len(result.clips))
        for path, clip in zip(paths, result.clips, strict=True):
            write_clip(clip, path, self.settings.export)
        return paths

    def _write(
        self,
        result: CleanResult,
        take: Take,
        body: int | None,
        merged: Merged | None,
        clips: list[Path],
    ) -> None:
        from kinefilter.pipeline.summary import as_tables

        if self.save_contacts is not None:
            write_contacts(result.clip, numbered(self.save_contacts, body))
        out.print(as_tables(result))
        out.print(f"wrote {', '.join(map(str, clips))}")
        if self.report is not None:
            from kinefilter.pipeline.look.comparison import compare
            from kinefilter.pipeline.look.page import read_limits, write_report

            path = numbered(self.report, body)
            comparison = compare(result.clip, take, merged)
            write_report(comparison, path, read_limits())
            out.print(f"wrote {path}")


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

    With --sessions '{name}_{sensor}.csv*' takes whose names differ only in {sensor} are
    of several sensors at the same time: they become one clip, NAME, as by 'kinefilter
    clean A B', and one row of the manifest. Other patterns: '{name}/{sensor}.csv' for a
    folder a session, '{sensor}/{name}.csv' for a folder a sensor. A take without a
    partner is cleaned by itself; a session whose takes do not belong together fails.

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
    sessions: str | None = None
    """Names of takes of several sensors, with {name} and {sensor}; * is anything. Also
    sessions = "..." in kinefilter.toml."""
    sensors: tuple[str, ...] = ()
    """What {sensor} may be; the clip has the clock and frame of the first. Default:
    anything, by the alphabet."""
    to: Literal[
        "usdc", "usda", "usd", "usdz", "glb", "vrma", "fbx", "bvh", "csv", "npz"
    ] = "usdc"
    """Format of the clips."""
    jobs: int | None = None
    """Number of processes; default: one per core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers clean instead; they
    must reach the same paths and URLs."""
    take_timeout: float | None = None
    """Seconds after which a take fails and the batch goes on; default: an hour and a
    minute for each megabyte of the take. On a cluster such a take ends its Dask worker,
    which is started again if it has a nanny."""
    fail_on_damage: bool = False
    """End with exit code 1 if the tracker failed in a take, or it has a long gap; the
    manifest says where."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file of options for all takes; kinefilter.toml in a folder overrides it."""
    settings: _Settings = field(default_factory=Settings)
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the takes, and print what became of them."""
        from kinefilter.pipeline.batch import as_tables, clean_files

        if not self.inputs:
            raise InputError("no takes given; name files or folders of takes")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: expected 1 or more")
        if self.take_timeout is not None and not self.take_timeout > 0:
            raise InputError(f"--take-timeout {self.take_timeout:g}: expected over 0 s")
        if self.jobs is not None and self.scheduler is not None:
            raise InputError("--jobs is for this machine; leave it or --scheduler out")
        settings = replace(self.settings, sessions=self.sessions, sensors=self.sensors)
        try:
            with _bar(self.scheduler) as show:
                outcome = clean_files(
                    self.inputs,
                    self.out,
                    settings,
                    suffix=f".{self.to}",
                    config_file=self.config_file,
                    given=self.given,
                    jobs=self.jobs,
                    scheduler=self.scheduler,
                    take_timeout=self.take_timeout,
                    on_progress=show,
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt("the same command again goes on") from None
        out.print(as_tables(outcome))
        damaged = self.fail_on_damage and outcome.damaged
        return 1 if outcome.failed or damaged else 0


@contextmanager
def _bar(scheduler: str | None) -> Iterator[OnProgress]:
    """Yield what shows how many takes are done, and when all will be."""
    told = False
    with progress_display(counted=False) as bars:
        task = bars.add_task("clean", visible=False)

        def show(progress: JobProgress) -> None:
            nonlocal told
            if progress.idle and not told:
                err.print(f"no worker; start one: dask worker {scheduler} --nthreads 1")
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
