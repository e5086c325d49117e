"""``kinefilter database``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from kinefilter.characters import SKELETONS, InputError

from .terminal import Skeletons, keep, out, progress_bars, read_all

__all__ = ["Database"]


@dataclass(frozen=True)
class DatabaseBuild:
    """Build a motion database from mocap."""

    files: Positional[tuple[Path, ...]]
    """Mocap: BVH (.gz too), AMC with its ASF, C3D of joint centers; or pairs files
    (.npz), of which the mocap is taken."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Database to write (.npz)."""
    skeleton: Skeletons = "kinect_v1"
    """Skeleton of the takes that it is for."""
    count: int = 2574
    """About how many postures to keep."""

    def run(self) -> int:
        """Build and write."""
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.library import database_from_mocap, database_from_pairs

        if self.out.suffix != ".npz":
            raise InputError(f"{self.out}: a database is an .npz file; name it so")
        if self.count < 2:
            raise InputError(f"--count {self.count}: a database needs two postures")
        check_folder(self.out)
        keep(self.out, *self.files)
        skeleton = SKELETONS[self.skeleton]
        paired = [file for file in self.files if file.suffix == ".npz"]
        if paired and len(paired) < len(self.files):
            raise InputError(f"{paired[0]}: give mocap or pairs files, not both")
        with progress_bars() as progress:
            if paired:
                pairs = read_all(paired)
                if (found := pairs[0].take.skeleton) != skeleton:
                    raise InputError(
                        f"{paired[0]}: pairs of {found.name}; add --skeleton "
                        f"{found.name}"
                    )
                database = database_from_pairs(
                    pairs, count=self.count, progress=progress
                )
            else:
                database = database_from_mocap(
                    self.files, skeleton, count=self.count, progress=progress
                )
        database.save(self.out)
        out.print(f"wrote {self.out}: {database.summary}")
        return 0


@dataclass(frozen=True)
class DatabaseInfo:
    """Say what a motion database holds."""

    file: Positional[Path]
    """Database (.npz)."""

    def run(self) -> int:
        """Read and print."""
        from kinefilter.pipeline.database import PostureDatabase

        database = PostureDatabase.load(self.file)
        out.print(f"{self.file}: {database.summary}")
        for label, count in sorted(Counter(database.labels.tolist()).items()):
            out.print(f"{count:6d} {label}", markup=False)
        return 0


@dataclass(frozen=True)
class Database:
    """Build motion databases, and look into them."""

    command: OmitSubcommandPrefixes[
        Annotated[DatabaseBuild, subcommand("build")]
        | Annotated[DatabaseInfo, subcommand("info")]
    ]

    def run(self) -> int:
        """Run the subcommand."""
        return self.command.run()
