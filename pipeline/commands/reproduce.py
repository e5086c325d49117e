"""``kinefilter reproduce``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import InputError

from .terminal import out, progress_bars


@dataclass(frozen=True)
class Reproduce:
    """Measure again what README and the papers say: a table and a plot per study.

    Studies of takes and of marker mocap: cleaned-takes, marker-mocap, untrained,
    methods-new-people, methods-known-people, failures, reliability; of speed: speed,
    million-postures; of the papers, on simulated takes: shum-table-3, shum-table-4,
    shum-figure-8, liu-figure-3, liu-figure-7, liu-table-5, chiang-figure-5.

    With --all every study and picture is made, and every figure of README is compared
    with the result, in some forty minutes on two cores; the exit code is 1 if one does
    not hold. The same command again makes only what is missing, or what was made by
    other code or from other recordings. Needs pip install "kinefilter[reproduce]"; the
    moving picture needs OpenGL, pictures of pages need viser, Chromium and a checkout.
    """

    studies: Positional[tuple[str, ...]] = ()
    """Names of studies."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for STUDY.csv and STUDY.png; made if it is missing."""
    all: Path | None = None
    """Make everything in this folder, and claims.csv: figures of README beside those
    measured."""
    data: Path | None = None
    """Folder of recordings; default: ../shared/data, if it exists: takes in
    takes/*/*.csv or .csv.gz, of which *_failure have gross failures and those in
    precog16 are punches and kicks, and pairs (like those of 'simulate --pairs') of one
    person each in ui-prmd/s*.npz, their clips named m01_... by the movement. Without
    recordings, people are simulated, and what needs recordings is not measured."""
    seed: int = 0
    """Seed of simulated people, performances and the sensor's errors."""
    quick: bool = False
    """Use a small part of everything, as a trial; the figures mean little."""

    def run(self) -> int:
        """Run the studies, write and print their results."""
        from kinefilter.pipeline.lab.studies import (
            STUDIES,
            check_drawing,
            check_names,
            check_studies_folder,
            recordings_folder,
        )

        given = (bool(self.studies), self.out is not None, self.all is not None)
        folder = self.out or self.all
        if folder is None or given not in ((True, True, False), (False, False, True)):
            raise InputError("give either studies and -o FOLDER, or --all FOLDER alone")
        names = self.studies if self.all is None else tuple(STUDIES)
        check_names(names)
        check_drawing()
        check_studies_folder(folder)
        data = recordings_folder(self.data)
        self._study(names, folder, data)
        return 0 if self.all is None else self._judge(folder, data)

    def _study(self, names: Sequence[str], folder: Path, data: Path | None) -> None:
        """Run studies, and write and print their results."""
        from kinefilter.pipeline.lab.studies import (
            as_table,
            made,
            reproduce,
            write_study,
        )

        stamp = made.fingerprint(data, seed=self.seed, quick=self.quick)
        for name in names:
            if self.all is not None and made.is_made(name, folder, stamp):
                out.print(f"{folder / name}.csv is there already\n")
                continue
            with progress_bars() as progress:
                study = reproduce(
                    name,
                    seed=self.seed,
                    quick=self.quick,
                    data=data,
                    progress=progress,
                )
            written = write_study(study, folder)
            made.say_made(name, folder, stamp)
            out.print(as_table(study))
            out.print(f"wrote {' and '.join(map(str, written))}\n")

    def _judge(self, folder: Path, data: Path | None) -> int:
        """Make the pictures, check the claims; return the exit code."""
        from kinefilter.pipeline.lab.studies import make_pictures, verdicts

        with progress_bars() as progress:
            for line in make_pictures(folder, progress=progress):
                out.print(line)
        found = verdicts.judge(folder, recordings=data is not None, quick=self.quick)
        written = verdicts.write_verdicts(found, folder)
        out.print(verdicts.verdicts_table(found))
        out.print(f"wrote {written}")
        return int(any(verdict.held is False for verdict in found))
