"""The commands of user studies: ``rate`` and ``ratings``."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import (
    check_output,
    check_outputs,
    out,
    progress_bars,
    write_json,
)
from kinefilter.pipeline.formats.plain import counted

from . import in_folders


@dataclass(frozen=True)
class Rate:
    """Make a page on which people grade clips without knowing the systems behind them.

    The page shows two clips of the same motion side by side, from the same camera, and
    asks for a grade from 1 to 9 for each, as in Shum et al. 2013 (Figure 6). Order and
    sides are random. The page works offline and contains no names of systems or files;
    these are in a key beside it, which raters should not get. Raters save their answers
    as JSON files, which 'kinefilter ratings' reads.
    """

    systems: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME=]CLIPS ...")]
    """For each system a clip or a folder of clips; its name is that of the file or
    folder unless given as NAME=PATH: raw=take.csv shum=shum/ default=clips/. Clips of
    the same motion must have the same file name. Takes are drawn as recorded, leveled
    to the floor of another system's clip."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Page to write (.html); the key is written beside it, PAGE.key.json."""
    reference: Path | None = None
    """The true motions, mocap or takes, as a file or a folder. They are shown beside
    the clips, and raters grade how accurate the clips are instead of how natural."""
    single: bool = False
    """Show one clip at a time, as in Shum et al., instead of two."""
    repeats: int = 2
    """Number of trials repeated at the end with sides swapped, to test whether raters
    are consistent."""
    seed: int = 0
    """Seed of the random order; the same seed gives the same page."""

    def run(self) -> int:
        """Write the page and its key."""
        from kinefilter.pipeline.lab import rating

        for name, number in (("--seed", self.seed), ("--repeats", self.repeats)):
            if number < 0:
                raise InputError(f"{name} {number}: must be at least 0")
        key = self.out.with_suffix(".key.json")
        check_output(self.out, suffix=".html")
        systems = rating.find_systems(self.systems)
        reference = rating.motions_of(self.reference) if self.reference else None
        read = [own.values() for own in (*systems.values(), reference or {})]
        check_outputs((self.out, key), *chain.from_iterable(read))
        with progress_bars() as progress:
            page = rating.write_rating_page(
                systems,
                self.out,
                key,
                reference=reference,
                single=self.single,
                repeats=self.repeats,
                seed=self.seed,
                progress=progress,
            )
        shown, trials = len(page["motions"]), len(page["trials"])
        for name, motions in systems.items():
            if unshared := len(motions) - shown:
                left_out = counted(unshared, "motion")
                out.print(f"{name}: left out {left_out} that other systems lack")
        counts = f"{counted(shown, 'motion')}, {counted(trials, 'trial')}"
        out.print(f"wrote {self.out}: {counts}")
        out.print(f"wrote {key}, which names the systems: do not show it to raters")
        return 0


@dataclass(frozen=True)
class Ratings:
    """Summarize the answers of raters: mean grades, and which systems differ.

    Prints means over raters with 95 % intervals (Student's t), standard deviations of
    the grades as in Figure 6 of Shum et al. 2013, how often each system got the higher
    of two grades, and for each two systems whether they differ, by Wilcoxon's
    signed-rank test with Holm's correction. The paper names no test.
    """

    answers: Positional[tuple[Path, ...]]
    """Files of answers saved by raters (.json), or folders of them."""
    key: Path
    """The key that 'kinefilter rate' wrote beside the page."""
    json: Path | None = None
    """Also write the figures to this JSON file."""

    def run(self) -> int:
        """Read the answers and print the tables."""
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
