"""The commands of user studies: ``rate`` and ``ratings``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import (
    check_output,
    keep,
    out,
    progress_bars,
    write_json,
)
from kinefilter.pipeline.formats.plain import counted

from .inputs import in_folders


@dataclass(frozen=True)
class Rate:
    """Make a page on which people grade clips, not knowing which system made them.

    The page shows two clips of the same motion side by side, from the same camera, and
    asks for a grade of each from 1 to 9, as Shum et al. 2013 did (Figure 6). Order and
    sides are shuffled. It needs no network and holds no names of systems and files;
    those are in a key beside it, which raters should not get. Raters save their answers
    as JSON files, which 'kinefilter ratings' reads.
    """

    systems: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME=]CLIPS ...")]
    """For each system a clip, or a folder of clips, named after it or as NAME=PATH:
    raw=take.csv shum=shum/ default=clips/. Motions are told apart by the names of
    the files. A take is drawn as recorded, leveled to the floor of another system's
    clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Page to write (.html); the key is written beside it, PAGE.key.json."""
    reference: Path | None = None
    """How the people really moved, mocap or a take, as a file or a folder: it is seen
    beside the clips, and grades say how accurate they are instead of how natural."""
    single: bool = False
    """Show one clip at a time, as Shum et al. did, instead of two."""
    repeats: int = 2
    """Trials that come once more at the end, their sides exchanged, to see whether
    raters agree with themselves."""
    seed: int = 0
    """Seed of what is shuffled: same seed, same page."""

    def run(self) -> int:
        """Read the clips, write the page and its key."""
        from kinefilter.pipeline.lab import rating

        for name, number in (("--seed", self.seed), ("--repeats", self.repeats)):
            if number < 0:
                raise InputError(f"{name} {number}: expected 0 or more")
        check_output(self.out, suffix=".html")
        key = self.out.with_suffix(".key.json")
        check_output(key)
        systems: dict[str, rating.Motions] = {}
        for word in self.systems:
            name, own = rating.find_system(word)
            if name in systems:
                raise InputError(
                    f"{word}: a second system called {name!r}; give it as NAME=PATH"
                )
            systems[name] = own
        path = self.reference
        reference = None if path is None else rating.motions_of(path)
        for own in (*systems.values(), reference or {}):
            for path in own.values():
                keep(self.out, path)
                keep(key, path)
        with progress_bars() as progress:
            made = rating.write_rating_page(
                systems,
                self.out,
                key,
                reference=reference,
                single=self.single,
                repeats=self.repeats,
                seed=self.seed,
                progress=progress,
            )
        motions, trials = len(made["motions"]), len(made["trials"])
        for name, own in systems.items():
            if len(own) > motions:
                out.print(f"{name}: left out {len(own) - motions} that others lack")
        told = f"{counted(motions, 'motion')}, {counted(trials, 'trial')}"
        out.print(f"wrote {self.out}: {told}")
        out.print(f"wrote {key}, which says whose clips they are: keep it from raters")
        return 0


@dataclass(frozen=True)
class Ratings:
    """Say what raters thought: mean grades of systems, and which differ.

    Means over raters with their 95 % interval (Student's), standard deviations of the
    grades as in Figure 6 of Shum et al. 2013, how often each system had the higher
    grade of two, and for each two systems whether they differ: Wilcoxon's signed ranks,
    corrected after Holm. The paper names no test.
    """

    answers: Positional[tuple[Path, ...]]
    """Files that raters have saved (.json), or folders of them."""
    key: Path
    """The key that 'kinefilter rate' wrote beside the page."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Read, compute, print."""
        from kinefilter.pipeline.lab import ratings

        files = in_folders(self.answers, (".json",))
        files = [file for file in files if file.resolve() != self.key.resolve()]
        check_output(self.json, *files, self.key)
        key = ratings.read_key(self.key)
        figures = ratings.summarize(ratings.read_answers(files, key), key)
        write_json(figures, self.json)
        for table in ratings.as_tables(figures):
            out.print(table)
        for doubt in ratings.doubts(figures):
            out.print(doubt)
        return 0
