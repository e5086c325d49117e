"""``kinefilter database``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from kinefilter.characters import SKELETONS, InputError

from .terminal import (
    Skeletons,
    check_output,
    clips_of,
    in_folders,
    keep,
    out,
    progress_bars,
)

_MOCAP = (".bvh", ".bvh.gz", ".amc", ".amc.gz", ".asf", ".c3d", ".npz")


@dataclass(frozen=True)
class DatabaseBuild:
    """Build a motion database from mocap."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """Database to write (.npz)."""
    files: Positional[tuple[Path, ...]] = ()
    """Mocap: BVH (.gz too), AMC with its ASF, C3D of joint centers; or pairs files
    (.npz), whose mocap is used. A folder stands for the files in it and in its folders;
    they may be larger than memory."""
    skeleton: Skeletons = "kinect_v1"
    """Skeleton of the takes to be cleaned with it."""
    count: int = 2574
    """About how many postures to keep."""
    scripted: bool = False
    """Build from scripted performances instead of files, like the built-in database."""

    def run(self) -> int:
        """Build the database and write it."""
        from kinefilter.pipeline.database.build import (
            database_from_mocap,
            database_from_pairs,
        )

        check_output(self.out, ".npz")
        if self.count < 2:
            raise InputError(f"--count {self.count}: expected 2 postures or more")
        if bool(self.files) == self.scripted:
            raise InputError("give either mocap files or --scripted")
        files = in_folders(self.files, _MOCAP)
        keep(self.out, *files)
        skeleton = SKELETONS[self.skeleton]
        paired = [file for file in files if file.suffix == ".npz"]
        if paired and len(paired) < len(files):
            raise InputError(f"{paired[0]}: give mocap or pairs files, not both")
        with progress_bars() as progress:
            if self.scripted:
                from kinefilter.pipeline.lab.scripted_database import scripted_database

                database = scripted_database(skeleton, progress)
            elif paired:
                pairs = clips_of(paired, progress)
                database = database_from_pairs(pairs, skeleton, count=self.count)
            else:
                database = database_from_mocap(
                    files, skeleton, count=self.count, progress=progress
                )
        database.save(self.out)
        out.print(f"wrote {self.out}: {database.summary}")
        return 0


@dataclass(frozen=True)
class DatabaseInfo:
    """Print what a motion database contains."""

    file: Positional[Path]
    """Database (.npz)."""

    def run(self) -> int:
        """Read the database and print its content."""
        from kinefilter.pipeline.database import PostureDatabase

        database = PostureDatabase.load(self.file)
        out.print(f"{self.file}: {database.summary}")
        for label, count in sorted(Counter(database.labels.tolist()).items()):
            out.print(f"{count:6d} {label}")
        return 0


@dataclass(frozen=True)
class Database:
    """Build motion databases, and print what they contain."""

    command: OmitSubcommandPrefixes[
        Annotated[DatabaseBuild, subcommand("build")]
        | Annotated[DatabaseInfo, subcommand("info")]
    ]

    def run(self) -> int:
        """Run the subcommand."""
        return self.command.run()
