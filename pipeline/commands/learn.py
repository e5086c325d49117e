"""The commands that learn from mocap: ``train`` and ``database``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from kinefilter.characters import SKELETONS, InputError
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.methods import LEARNED, LearnedName
from kinefilter.pipeline.presets import PresetName

from .terminal import Skeletons, check_output, clips_of, in_folders, out, progress_bars

_MOCAP = (".bvh", ".bvh.gz", ".amc", ".amc.gz", ".asf", ".c3d", ".npz")


@dataclass(frozen=True)
class Train:
    """Teach a correction method from pairs of Kinect and mocap.

    The weights that clean has by default (pipeline/embedded/learned.npz) are what the
    six files of UI-PRMD and the sessions of two Kinects teach, in some minutes. learned
    learns from simulated people as well, beside the recorded ones.
    """

    out: Annotated[Path, arg(aliases=["-o"])]
    """Model to write (.npz)."""
    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files (.npz), or folders of them; they may be larger than memory."""
    simulated: Skeletons | None = None
    """Learn from simulated pairs of this skeleton, in place of files."""
    furnished: bool = False
    """Simulate people with things before them and in their hands, not alone."""
    method: LearnedName = "learned"
    """What to teach."""
    preset: PresetName | None = None
    """Teach a paper's system instead, with its constants, on the frames that its
    reliability lets through."""
    set: tuple[str, ...] = ()
    """Parameters of --preset or --method, such as clusters=50; an unknown name lists
    them."""
    views: tuple[Path, ...] = ()
    """Sessions of two sensors, NAME.sync.csv beside NAME_A and NAME_B, or folders of
    them: they teach learned how limbs on the far side of the body move."""
    people: bool = False
    """Let learned know the people in the pairs by name, for clean --person."""

    def run(self) -> int:
        """Learn and write."""
        from kinefilter.pipeline.lab.simulate import furnished_pairs, simulated_pairs
        from kinefilter.pipeline.lab.teach import teach
        from kinefilter.pipeline.lab.training import training_set
        from kinefilter.pipeline.lab.two_views import find_sessions, view_pairs
        from kinefilter.pipeline.models import Model, save_model

        config = CleanConfig(preset=self.preset, set=self.set)
        if self.preset is None:
            config = CleanConfig(method=self.method, set=self.set)
        method = config.method or self.method
        if method not in LEARNED:
            raise InputError(
                f"--preset {self.preset} does not learn from pairs: 'kinefilter "
                "database build' makes what it needs"
            )
        if bool(self.pairs) == (self.simulated is not None):
            raise InputError("give pairs files or --simulated SKELETON, not both")
        if self.furnished and self.simulated is None:
            raise InputError("--furnished needs --simulated SKELETON")
        if method != "learned" and (self.views or self.people):
            raise InputError(f"--views and --people are for learned, not {method}")
        files = in_folders(self.pairs, (".npz",))
        check_output(self.out, *files, suffix=".npz")
        sessions = find_sessions(self.views, None)
        with progress_bars() as progress:
            if self.simulated is None:
                lessons = training_set(clips_of(files, progress), config)
            else:
                simulated = furnished_pairs if self.furnished else simulated_pairs
                pairs = simulated(self.simulated, progress=progress)
                lessons = training_set(pairs, config)
            views, source = None, lessons.source
            if sessions:
                views = training_set(view_pairs(sessions, progress))
                source += f", and before two sensors {views.source}"
            learner = teach(
                method,
                lessons,
                views=views,
                people=self.people,
                settings=config.parameters.method,
                progress=progress,
            )
        model = Model(learner, method, lessons.skeleton, source, self.preset)
        save_model(model, self.out)
        asked = f"{self.preset}, " if self.preset else ""
        out.print(f"wrote {self.out}: {asked}{method}, learned from {source}")
        return 0


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
        from kinefilter.pipeline.lab import database_build as build

        if self.count < 2:
            raise InputError(f"--count {self.count}: expected 2 postures or more")
        if bool(self.files) == self.scripted:
            raise InputError("give either mocap files or --scripted")
        files = in_folders(self.files, _MOCAP)
        check_output(self.out, *files, suffix=".npz")
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
                database = build.database_from_pairs(pairs, skeleton, count=self.count)
            else:
                database = build.database_from_mocap(
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
