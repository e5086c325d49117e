"""The commands ``clean`` and ``batch``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os.path import realpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg

from kinefilter.characters import InputError
from kinefilter.characters.gaps import parts_of
from kinefilter.pipeline.edits import edits_beside
from kinefilter.pipeline.formats import Recording, check_writable, write_contacts
from kinefilter.pipeline.formats.clips import write_clip, write_people
from kinefilter.pipeline.formats.export import timing_notes, with_frame_rate
from kinefilter.pipeline.formats.files import as_path, numbered, part_paths
from kinefilter.pipeline.settings import Settings, overlaid, read_settings

from .terminal import (
    check_calibration,
    check_output,
    check_outputs,
    err,
    logger,
    out,
    progress_bars,
    progress_display,
    write_json,
)

if TYPE_CHECKING:
    from kinefilter.characters import Take
    from kinefilter.pipeline.batch.run import OnProgress, Outcome
    from kinefilter.pipeline.clean_result import CleanResult
    from kinefilter.pipeline.merge import Merged


_Settings = OmitArgPrefixes[Annotated[Settings, arg(name="")]]


@dataclass(frozen=True)
class Clean:
    """Clean a Kinect take and write it as an animation clip.

    Simultaneous takes of a person by several sensors become one clip; see 'kinefilter
    merge'.
    """

    takes: Positional[tuple[Path, ...]]
    """Recording in any of the formats of --format, gzipped or not. For several sensors,
    give one recording from each; the clip uses the clock of the first."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Clip to write; its extension selects the format: .usda .usdc .usd .usdz .glb
    .vrma .fbx .bvh .csv .npz."""
    settings: _Settings = field(default_factory=Settings)
    save_contacts: Path | None = None
    """Also write a CSV table of foot contacts, which can be edited and passed to
    --contacts."""
    report: Path | None = None
    """Also write a web page (.html) that shows the clip beside the take."""
    json: Path | None = None
    """Also write the printed figures to this JSON file."""
    one_file: bool = False
    """With --body all and .glb: write all people into one file, each with a skeleton
    and skin, instead of one file per person. kinefilter cannot read such a file
    back."""
    fail_on_damage: bool = False
    """Exit with code 1 if a tracker failure or a long gap is found."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file with options, such as cutoff = 4.0; the command line overrides it."""
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the take, write the clip, and print its figures."""
        settings = _changed(self.settings, self.config_file, self.given)
        own, config = [realpath(take) for take in self.takes], settings.config
        others = tuple(p for p in config.same_person if realpath(p) not in own)
        if others != config.same_person:
            out.print("--same-person names the take itself, which is ignored")
            settings = replace(settings, config=replace(config, same_person=others))
        return replace(self, settings=settings)._run()

    def _run(self) -> int:
        from kinefilter.pipeline.summary import as_json

        settings = self.settings
        if not self.takes:
            raise InputError("no take given; give the path of a recording")
        for place in self.takes:
            if as_path(place).is_dir():
                raise InputError(f"{place}: is a folder; use 'kinefilter batch' for it")
        check_calibration(settings.calibration, self.takes)
        used = [*self.takes, self.config_file, *settings.files]
        self._check(used)
        recordings = [settings.read(path) for path in self.takes]
        edits, one = edits_beside(self.takes[0]), settings.body != "all"
        if one and settings.config.edits is None and edits.exists():
            err.print(f"kinefilter: to apply {edits}, add --edits {edits}")
        recording, numbers = recordings[0], settings.people(recordings)
        several = len(numbers) > 1
        others = (self.json, self.save_contacts, self.report)
        for body in numbers:
            number, take = body if several else None, recording.take(body)
            clip = None if self.one_file else number
            split = settings.config.gaps == "split"
            parts = parts_of(take.time) if split else [slice(None)]
            paths = part_paths(numbered(self.out, clip), len(parts))
            for path, part in zip(paths, parts, strict=True):
                check_output(path, *used, *others)
                time, suffix = take.time[part], self.out.suffix.lower()
                with_frame_rate(settings.export, suffix, time, take.source)
            for written in others[1:] if several else ():
                if written is not None:
                    check_output(numbered(written, number), *used, self.json)
        results = self._cleaned(recordings, numbers)
        if self.one_file:
            clips = [result.clip for result, _ in results.values()]
            write_people(clips, self.out, settings.export)
            out.print(f"wrote {self.out}")
        for body, (result, merged) in results.items():
            take = merged.take if merged else recording.take(body)
            self._write(result, take, body if several else None, merged)
        figures = {body: as_json(result) for body, (result, _) in results.items()}
        only = next(iter(figures.values()))
        write_json({"bodies": figures} if several else only, self.json)
        merges = [merged for _, merged in results.values() if merged]
        merge_notes = [note for merged in merges for note in merged.all_notes()]
        for note in (*recording.notes, *merge_notes, *settings.left_out(recordings)):
            out.print(note)
        damaged = any(result.damage for result, _ in results.values())
        left_out = several and len(results) < len(recording.takes)
        return 1 if left_out or (self.fail_on_damage and damaged) else 0

    def _check(self, used: list[Path | None]) -> None:
        """Raise an InputError if an output cannot be written or is also an input."""
        settings, export = self.settings, self.settings.export
        alone = {
            "--begin, --end and --loop": export.begin or export.end or export.loop,
            "--gaps split": settings.config.gaps == "split",
        }
        for what, given in alone.items():
            if self.one_file and given:
                raise InputError(f"{what} cannot be combined with --one-file")
        one_glb = settings.body == "all" and self.out.suffix.lower() == ".glb"
        if self.one_file and not one_glb:
            raise InputError("--one-file requires --body all and a .glb clip")
        check_writable(self.out, export)
        check_output(self.report, suffix=".html")
        check_outputs((self.out, self.json, self.save_contacts, self.report), *used)

    def _cleaned(
        self, recordings: list[Recording], numbers: list[int]
    ) -> dict[int, tuple[CleanResult, Merged | None]]:
        """Return the results of the people who can be cleaned, by number."""
        settings = self.settings
        for name in ("contacts", "edits"):
            if getattr(settings.config, name) is not None and len(numbers) > 1:
                hint = "choose one with --body"
                raise InputError(f"--{name} applies to one person; {hint}")
        results = {}
        with progress_bars() as progress:
            cleaned = settings.clean(recordings, numbers, progress=progress)
            for number, result, merged in cleaned:
                if not isinstance(result, InputError):
                    suffix = self.out.suffix.lower()
                    timing = timing_notes(settings.export, suffix, result.clips)
                    result = replace(result, notes=(*result.notes, *timing))
                    results[number] = result, merged
                elif number == numbers[-1] and not results:
                    raise result
                else:
                    err.print(f"kinefilter: {result}; skipped")
        return results

    def _write(
        self, result: CleanResult, take: Take, body: int | None, merged: Merged | None
    ) -> None:
        from kinefilter.pipeline.summary import as_tables

        clips = list[Path]()
        if not self.one_file:
            clips = part_paths(numbered(self.out, body), len(result.clips))
            for path, clip in zip(clips, result.clips, strict=True):
                write_clip(clip, path, self.settings.export)
        if self.save_contacts is not None:
            write_contacts(result.clip, numbered(self.save_contacts, body))
        out.print(as_tables(result))
        if clips:
            out.print(f"wrote {', '.join(map(str, clips))}")
        if self.report is not None:
            from kinefilter.pipeline.look.comparison import compare
            from kinefilter.pipeline.look.page import write_report

            path = numbered(self.report, body)
            write_report(compare(result.clip, take, merged), path)
            out.print(f"wrote {path}")


@dataclass(frozen=True)
class Batch:
    """Clean all takes in folders; run it again to resume.

    Files that are not takes are skipped, and so are .bvh clips from kinefilter and
    links to folders, which can be given as folders of their own. OUT/manifest.jsonl (at
    a URL: OUT/manifest/*.jsonl) gets a line for each finished take; OUT/manifest.csv is
    the table of them. Takes that are no longer given keep their clips and rows: OUT may
    be the folder of several batches. A take is cleaned again if it failed, if its clip
    is missing, or if anything changed: the take, its clip, the options, a database or
    model, or kinefilter's version. A file kinefilter.toml in a folder holds options for
    the takes in it and its subfolders, such as cutoff = 4.0 or rotation-order = "xyz";
    options on the command line override it. Edits that 'kinefilter view' saved beside a
    take, as NAME.edits.toml, are applied, unless --edits names others or --body is all.

    With --sessions '{name}_{sensor}.csv*', takes whose names differ only in {sensor}
    are treated as simultaneous: they become one clip, NAME, as with 'kinefilter clean A
    B', and one row of the manifest. Other patterns: '{name}/{sensor}.csv' for one
    folder per session, '{sensor}/{name}.csv' for one folder per sensor. A take without
    a partner is cleaned alone; a session whose takes do not match fails.

    URLs may be any that fsspec supports, such as s3://bucket/takes after pip install
    s3fs; remote stores cannot be locked, so run one batch at a time into each. With
    --scheduler, every worker needs pip install "kinefilter[cluster]"; workers may join
    and leave. Start them with dask scheduler --host 127.0.0.1, then dask worker
    tcp://127.0.0.1:8786 --nworkers 2 --nthreads 1. Keep the scheduler on a private
    network: anyone who can reach it can run code.
    """

    inputs: Positional[tuple[str, ...]]
    """Takes, and folders to search for takes, as paths or URLs such as
    s3://bucket/takes."""
    out: Annotated[str, arg(aliases=["-o"])]
    """Output folder, a path or URL: clips in the same tree as the takes, and the
    manifest."""
    sessions: str | None = None
    """Pattern of the file names of simultaneous takes, with {name}, {sensor} and the
    wildcard *. Can also be set as sessions = "..." in kinefilter.toml."""
    sensors: tuple[str, ...] = ()
    """Allowed values of {sensor}; the clip uses the clock and frame of reference of the
    first. Default: any, in alphabetical order."""
    to: Literal[
        "usdc", "usda", "usd", "usdz", "glb", "vrma", "fbx", "bvh", "csv", "npz"
    ] = "usdc"
    """Format of the clips."""
    jobs: int | None = None
    """Number of processes; default: one per core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers do the cleaning; they
    must have access to the same paths and URLs."""
    take_timeout: float | None = None
    """Seconds after which a take fails and the batch continues; default: one hour plus
    one minute per megabyte of the take. On a cluster, such a take ends its Dask worker,
    which restarts if it has a nanny."""
    fail_on_damage: bool = False
    """Exit with code 1 if any take has a tracker failure or a long gap; the manifest
    lists them."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file with options for all takes; a folder's kinefilter.toml overrides it."""
    settings: _Settings = field(default_factory=Settings)
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the takes and print a summary."""
        from kinefilter.pipeline.batch.outcome_tables import as_tables
        from kinefilter.pipeline.batch.run import clean_files

        if not self.inputs:
            raise InputError("no takes given; give files or folders of takes")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: must be at least 1")
        if self.take_timeout is not None and not self.take_timeout > 0:
            wrong = "must be greater than 0"
            raise InputError(f"--take-timeout {self.take_timeout:g}: {wrong}")
        if self.jobs is not None and self.scheduler is not None:
            raise InputError("--jobs cannot be combined with --scheduler")
        own = replace(self.settings, sessions=self.sessions, sensors=self.sensors)
        settings = _changed(own, self.config_file, self.given)
        try:
            with _bar(self.scheduler) as show:
                outcome = clean_files(
                    self.inputs,
                    self.out,
                    settings,
                    suffix=f".{self.to}",
                    given=self.given,
                    jobs=self.jobs,
                    scheduler=self.scheduler,
                    take_timeout=self.take_timeout,
                    on_progress=show,
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt("run the same command again to resume") from None
        out.print(as_tables(outcome))
        damaged = self.fail_on_damage and outcome.damaged
        return 1 if outcome.failed or damaged else 0


def _changed(settings: Settings, file: Path | None, given: Collection[str]) -> Settings:
    """Return settings changed by the file of --config, except for those ``given``."""
    return settings if file is None else overlaid(settings, read_settings(file), given)


@contextmanager
def _bar(scheduler: str | None) -> Iterator[OnProgress]:
    """Yield a callback that displays the progress of a batch."""
    warned = False
    with progress_display(counted=False) as bars:
        log = logger()
        task = bars.add_task("clean", visible=False)

        def show(outcome: Outcome) -> None:
            nonlocal warned
            if outcome.idle and not warned:
                err.print(
                    f"no workers; start one with: dask worker {scheduler} --nthreads 1"
                )
                warned = True
            words = f"clean {len(outcome.rows)}/{outcome.takes}"
            if outcome.failed:
                words += f", {len(outcome.failed)} failed"
            log(words)
            bars.update(task, completed=outcome.size_done, total=outcome.size)
            bars.update(task, description=words, visible=True)

        yield show
