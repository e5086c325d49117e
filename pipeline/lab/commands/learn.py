"""The commands that learn from mocap: ``pair``, ``train`` and ``database``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitSubcommandPrefixes, Positional, arg, subcommand

from kinefilter.characters import SKELETONS, InputError
from kinefilter.pipeline.commands.terminal import (
    Skeletons,
    check_output,
    err,
    out,
    progress_bars,
    write_json,
)
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.methods import LEARNED, LearnedName
from kinefilter.pipeline.presets import PresetName

from .inputs import clips_of, in_folders

_MOCAP = (".bvh", ".bvh.gz", ".amc", ".amc.gz", ".asf", ".c3d", ".trc", ".npz")


@dataclass(frozen=True)
class Pair:
    """Make training pairs of Kinect takes and mocap of the same movement.

    Clocks and axes may be any. The lag is found from how the movements correlate, then
    one rigid transform from where the joints are, which all takes share: sensor and
    mocap have to stand still. What cannot be trusted is left out and told. A take whose
    mocap explains too little of its movement is left out (exit code 1; 2 if none is
    left). That finds other movements and people, but only two in three of other
    repetitions of the same short movement.
    """

    files: Positional[tuple[Path, ...]]
    """Takes of one person, and after each its mocap: C3D or TRC of markers, or BVH, AMC
    (its ASF beside it), C3D or TRC with joints."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Pairs to write (.npz), for train and evaluate."""
    subject: str | None = None
    """Who moves; default: the name of the output."""
    markers: Path | None = None
    """Where joints lie among the markers (.toml), as in
    pipeline/lab/embedded/plug_in_gait.toml, which is the default."""
    least: float = 0.55
    """Share of a take's movement that its mocap has to explain, 0 to 1."""
    picture: Path | None = None
    """Also draw how far each joint is from the mocap (.png)."""
    json: Path | None = None
    """Write lags, transforms and what was left out to this file too."""

    def run(self) -> int:
        """Pair, write, print."""
        from kinefilter.pipeline.formats.mocap import read_mocap
        from kinefilter.pipeline.formats.takes import read_take
        from kinefilter.pipeline.lab import pairing_report as report
        from kinefilter.pipeline.lab.marker_sets import read_marker_set
        from kinefilter.pipeline.lab.pairing import pair_session
        from kinefilter.pipeline.lab.simulate import write_pairs
        from kinefilter.pipeline.lab.studies import check_drawing

        if len(self.files) < 2 or len(self.files) % 2:
            raise InputError(
                f"{counted(len(self.files), 'file')} given; give takes, and after each "
                "its mocap: TAKE MOCAP TAKE MOCAP ..."
            )
        if not 0.0 <= self.least <= 1.0:
            raise InputError(f"--least {self.least:g}: expected a share, 0 to 1")
        for path, suffix in ((self.out, ".npz"), (self.picture, ".png")):
            check_output(path, *self.files, suffix=suffix)
        check_output(self.json, *self.files)
        if self.picture is not None:
            check_drawing()
        table = None if self.markers is None else read_marker_set(self.markers)
        recordings = [
            (read_take(take), read_mocap(mocap))
            for take, mocap in zip(self.files[::2], self.files[1::2], strict=True)
        ]
        with progress_bars() as progress:
            pairings, refused = pair_session(
                recordings,
                subject=self.subject or self.out.stem,
                table=table,
                least=self.least,
                progress=progress,
            )
        write_pairs([p.pair for p in pairings], self.out)
        if self.picture is not None:
            report.draw_residuals(pairings, self.picture)
        figures = [report.figures_of(p) for p in pairings]
        write_json({"takes": figures, "left_out": refused}, self.json)
        out.print(report.as_table(pairings))
        for p in pairings:
            for note in p.notes:
                out.print(f"{p.pair.clip}: {note}")
        for reason in refused:
            err.print(f"left out: {reason}")
        out.print(f"wrote {self.out}: {len(pairings)} clips")
        return int(bool(refused))


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
    """Mocap: BVH (.gz too), AMC with its ASF, C3D or TRC of joint centers; or pairs
    files (.npz), whose mocap is used. A folder stands for the files in it and in its
    folders; they may be larger than memory."""
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
