"""``kinefilter evaluate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from kinefilter.characters import InputError

from .terminal import clips_of, keep, out, progress_bars, write_json


@dataclass(frozen=True)
class Evaluate:
    """Measure correction methods against marker mocap.

    Each method corrects in the place of clean's own, and the clip that comes out is
    compared with the mocap: E, the distance of limb joints relative to the middle of
    the hips; E_std, the same with both sides at standard bone lengths; E_var, the same
    without each joint's constant offset over a clip, which is what one sees as wrong
    motion. Means over frames and joints, then over people, in cm, and against raw.

    default is exactly what clean does, with the weights that ship: they were learned on
    the six people of UI-PRMD, so learned tells what it is worth to others. none is
    clean without any correction.
    """

    train: tuple[Path, ...] = ()
    """Pairs files (.npz) to learn from; none for methods that do not learn."""
    test: tuple[Path, ...] = ()
    """Pairs files to test on; default: one person of --train after the other."""
    methods: str = (
        "none,butterworth,savgol,one-euro,kalman,low-rank,local-pca,default,"
        "exemplar,full-gp,local-gp,clustered-gp,learned"
    )
    """Methods, comma-separated."""
    protocol: Literal["people", "repetitions"] = "people"
    """Test on people, or on repetitions of known people, that were not learned from."""
    physics: bool = True
    """Pull the simulated character through what the methods give, as clean does."""
    ablation: bool = False
    """Also measure methods without a part of them: local-gp without terms of its
    energy (Liu 2016, Table 5), Shum's methods A and B beside local-pca."""
    database: Path | None = None
    """Motion database (.npz) for methods that need one; default: the built-in one,
    which the method default always has."""
    mocap_database: bool = False
    """Take the mocap of the clips that are learned from for the motion database."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Evaluate and print."""
        from kinefilter.pipeline.database import PostureDatabase
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.lab.evaluate import as_table, evaluate

        if self.json is not None:
            check_folder(self.json)
            keep(self.json, *self.train, *self.test, self.database)
        if self.mocap_database and self.database is not None:
            raise InputError("give --database or --mocap-database, not both")
        database: PostureDatabase | Literal["mocap"] | None = None
        if self.mocap_database:
            database = "mocap"
        elif self.database is not None:
            database = PostureDatabase.load(self.database)
        with progress_bars() as progress:
            train, test = (
                list(clips_of(files, progress)) for files in (self.train, self.test)
            )
            figures = evaluate(
                train,
                test,
                self.methods.split(","),
                protocol=self.protocol,
                physics=self.physics,
                ablation=self.ablation,
                database=database,
                progress=progress,
            )
        if self.json is not None:
            write_json(figures, self.json)
        out.print(as_table(figures))
        return 0
