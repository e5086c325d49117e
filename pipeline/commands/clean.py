"""``kinefilter clean``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, Suppress, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.config import CleanConfig, TakeFormat
from kinefilter.pipeline.formats.export import Export
from kinefilter.pipeline.settings import Settings

from .terminal import err, keep, out, progress_bars, write_json

if TYPE_CHECKING:
    from kinefilter.characters import Take
    from kinefilter.pipeline.cleaner import CleanResult
    from kinefilter.pipeline.formats import Recording


@dataclass(frozen=True)
class Clean:
    """Clean a Kinect take and write it as an animation clip."""

    take: Positional[Path]
    """Recording in any of the formats of --format; .gz too."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Clip to write; the extension decides: .usda .usdc .usd .usdz .bvh .csv
    .npz."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    export: OmitArgPrefixes[Export] = field(default_factory=Export)
    format: TakeFormat | None = None
    """Layout of the take; default: detected from its content."""
    body: int | Literal["all"] | None = None
    """Which person, counted from 1 in order of appearance, or all: a clip each,
    clip.1.usda, clip.2.usda and so on; default: the person seen in most frames."""
    save_contacts: Path | None = None
    """Also write when which foot stands as a table (CSV), to edit and to use again."""
    report: Path | None = None
    """Also write a web page that shows clip and take side by side, .html."""
    json: Path | None = None
    """Also write the printed figures to this file."""
    config_file: Annotated[Path | None, arg(name="config")] = None
    """TOML file of options such as cutoff = 4.0; options given here override it."""
    given: Suppress[frozenset[str]] = frozenset()

    def run(self) -> int:
        """Clean the take, write the clip, and print its figures."""
        from kinefilter.pipeline.config_files import overlaid, read_settings

        settings = Settings(self.config, self.export, self.format, self.body)
        if self.config_file is None:
            return self._run(settings)
        settings = overlaid(settings, [read_settings(self.config_file)], self.given)
        chosen = replace(
            self,
            config=settings.config,
            export=settings.export,
            format=settings.format,
            body=settings.body,
        )
        return chosen._run(settings)

    def _run(self, settings: Settings) -> int:
        from kinefilter.pipeline.formats.recording import numbered
        from kinefilter.pipeline.formats.takes import read_recording
        from kinefilter.pipeline.summary import as_json

        used = [self.take, self.config_file, *settings.files]
        self._check(used)
        recording = read_recording(self.take, format=self.format)
        several = len(recording.takes) > 1 and self.body == "all"
        for body in recording.numbers(self.body) if several else ():
            for written in (self.out, self.save_contacts, self.report):
                if written is not None:
                    keep(numbered(written, body), *used, self.json)
        results = self._cleaned(recording)
        for body, result in results.items():
            self._write(result, recording.take(body), body if several else None)
        if self.json is not None:
            figures = {body: as_json(result) for body, result in results.items()}
            only = next(iter(figures.values()))
            write_json({"bodies": figures} if several else only, self.json)
        for note in recording.notes:
            out.print(note)
        count = len(recording.takes)
        if count > 1 and self.body is None:
            out.print(
                f"body {recording.main + 1} of {count}, seen in most frames; --body 1 "
                f"to {count} cleans another, --body all cleans each"
            )
        return 1 if several and len(results) < count else 0

    def _check(self, used: list[Path | None]) -> None:
        """Raise an InputError for files that cannot be written or must be kept."""
        from kinefilter.pipeline.formats import check_folder, check_writable
        from kinefilter.pipeline.look import check_report

        check_writable(self.out, self.export)
        written: list[Path | None] = []
        for path, check in (
            (self.out, check_folder),
            (self.json, check_folder),
            (self.save_contacts, check_folder),
            (self.report, check_report),
        ):
            if path is not None:
                check(path)
                keep(path, *used, *written)
            written.append(path)

    def _cleaned(self, recording: Recording) -> dict[int, CleanResult]:
        """Return the result of each person asked for, by their number."""
        from kinefilter.pipeline.cleaner import clean

        numbers = recording.numbers(self.body)
        if self.config.contacts is not None and len(numbers) > 1:
            raise InputError("--contacts is for one person; choose one with --body")
        results: dict[int, CleanResult] = {}
        for number in numbers:
            take = recording.take(number)
            try:
                with progress_bars() as progress:
                    results[number] = clean(take, self.config, progress=progress)
            except InputError as error:
                if number == numbers[-1] and not results:
                    raise
                err.print(f"kinefilter: {error}; left out")
        return results

    def _write(self, result: CleanResult, take: Take, body: int | None) -> None:
        from kinefilter.pipeline.formats import write_clip, write_contacts
        from kinefilter.pipeline.formats.recording import numbered
        from kinefilter.pipeline.look import compare, read_limits, write_report
        from kinefilter.pipeline.summary import as_tables

        path = numbered(self.out, body)
        write_clip(result.clip, path, self.export)
        if self.save_contacts is not None:
            write_contacts(result.clip, numbered(self.save_contacts, body))
        out.print(as_tables(result))
        out.print(f"wrote {path}")
        if self.report is not None:
            path = numbered(self.report, body)
            write_report(compare(result.clip, take), path, read_limits())
            out.print(f"wrote {path}")
