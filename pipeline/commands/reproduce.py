"""``kinefilter reproduce``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import InputError

from .terminal import out, progress_bars


@dataclass(frozen=True)
class Reproduce:
    """Measure again what README and the papers say: a table and a plot for each study.

    Studies of takes and of marker mocap: cleaned-takes, marker-mocap, untrained,
    methods-new-people, methods-known-people, failures, reliability; of speed: speed,
    million-postures; of the papers, on simulated takes: shum-table-3, shum-table-4,
    shum-figure-8, liu-figure-3, liu-figure-7, liu-table-5, chiang-figure-5.

    With --all, every study and picture is made and every figure of README compared with
    what was measured, in about forty minutes on two cores; the exit code is 1 if one
    does not hold. The same command again makes only what is missing or was made with
    other code or recordings. Needs pip install "kinefilter[reproduce]"; the animation
    needs OpenGL, pictures of pages need viser, Chromium and a checkout.
    """

    studies: Positional[tuple[str, ...]] = ()
    """Names of studies."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder to write STUDY.csv and STUDY.png into; created if it is missing."""
    all: Path | None = None
    """Make everything in this folder, and claims.csv: figures of README beside those
    measured."""
    data: Path | None = None
    """Folder of recordings, by default ../shared/data if it exists. It holds takes in
    takes/*/*.csv or .csv.gz, where *_failure have gross failures and those in precog16
    are punches and kicks, and pairs (as 'simulate --pairs' writes), one person each,
    in ui-prmd/s*.npz, their clips named m01_... by the movement. Without recordings,
    people are simulated, and what needs recordings is not measured."""
    seed: int = 0
    """Seed of simulated people, performances and the sensor's errors."""
    quick: bool = False
    """Use a small part of everything, as a trial; the figures mean little."""

    def run(self) -> int:
        """Study, write, print."""
        from kinefilter.pipeline.lab import studies

        if self.all is not None and (self.studies or self.out is not None):
            raise InputError("give --all FOLDER alone, or studies and -o FOLDER")
        folder = self.out if self.all is None else self.all
        if folder is None or (self.all is None and not self.studies):
            raise InputError("give studies and -o FOLDER, or --all FOLDER")
        names = self.studies if self.all is None else tuple(studies.STUDIES)
        studies.check_names(names)
        studies.check_drawing()
        studies.check_studies_folder(folder)
        data = studies.recordings_folder(self.data)
        stamp = studies.fingerprint(data, seed=self.seed, quick=self.quick)
        for name in names:
            if self.all is not None and studies.is_made(name, folder, stamp):
                out.print(f"{folder / name}.csv is up to date\n")
            else:
                self._study(name, folder, data)
                studies.note_made(name, folder, stamp)
        return 0 if self.all is None else self._judge(folder, data)

    def _study(self, name: str, folder: Path, data: Path | None) -> None:
        """Run a study, write and print it."""
        from kinefilter.pipeline.lab.studies import (
            Options,
            as_table,
            reproduce,
            write_study,
        )

        with progress_bars() as progress:
            options = Options(self.seed, data, progress)
            study = reproduce(name, options, quick=self.quick)
        written = write_study(name, study, folder)
        out.print(as_table(study))
        out.print(f"wrote {' and '.join(map(str, written))}\n")

    def _judge(self, folder: Path, data: Path | None) -> int:
        """Make the pictures, judge the claims; return the exit code."""
        from kinefilter.pipeline.lab.studies import claims, make_pictures

        with progress_bars() as progress:
            for line in make_pictures(folder, progress=progress):
                out.print(line)
        found = claims.judge(folder, recordings=data is not None, quick=self.quick)
        written = claims.write_verdicts(found, folder)
        out.print(claims.verdicts_table(found))
        out.print(f"wrote {written}")
        return int(any(verdict.held is False for verdict in found))
