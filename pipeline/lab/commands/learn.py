"""The commands that learn from recordings: ``pair``, ``train`` and ``database``."""

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
from kinefilter.pipeline.methods import LEARNED, LearnedName, PresetName

from . import clips_of, in_folders

_MOCAP = (".bvh", ".bvh.gz", ".amc", ".amc.gz", ".asf", ".c3d", ".trc", ".npz")


@dataclass(frozen=True)
class Pair:
    """Make training pairs from Kinect takes and mocap of the same movement.

    The two recordings of a pair need neither a common clock nor common axes. Their lag
    is found by correlating the movements, then one rigid transform, common to all
    takes, by aligning the joints; sensor and mocap system must therefore stay in place.
    Frames and joints that cannot be trusted are left out and reported.

    A take whose mocap explains too little of its movement is left out; the exit code is
    then 1, or 2 if no take remains. This detects mocap of a different movement or
    person, but only two in three cases of another repetition of the same short
    movement.
    """

    files: Positional[tuple[Path, ...]]
    """Takes of one person, each followed by its mocap: C3D or TRC of markers, or BVH,
    AMC (with its ASF beside it), C3D or TRC of joint centers."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Pairs file to write (.npz), for train and evaluate."""
    subject: str | None = None
    """Name of the person; default: the name of the output file."""
    markers: Path | None = None
    """Table that locates joints among the markers (.toml); default: Plug-in Gait, in
    pipeline/lab/embedded/plug_in_gait.toml."""
    least: float = 0.55
    """Minimum share of a take's movement that its mocap must explain, 0 to 1."""
    picture: Path | None = None
    """Also plot the distance of each joint from the mocap (.png)."""
    json: Path | None = None
    """Also write lags, transforms and what was left out to this JSON file."""

    def run(self) -> int:
        """Match takes with mocap, write the pairs, and print how well they match."""
        from kinefilter.pipeline.formats.mocap import read_mocap
        from kinefilter.pipeline.formats.takes import read_take
        from kinefilter.pipeline.lab import pairing_report as report
        from kinefilter.pipeline.lab.marker_sets import read_marker_set
        from kinefilter.pipeline.lab.pairing import pair_session
        from kinefilter.pipeline.lab.simulation import write_pairs
        from kinefilter.pipeline.lab.studies.study import check_drawing

        if len(self.files) < 2 or len(self.files) % 2:
            raise InputError(
                f"{counted(len(self.files), 'file')} given; give each take followed by "
                "its mocap: TAKE MOCAP TAKE MOCAP ..."
            )
        if not 0.0 <= self.least <= 1.0:
            raise InputError(f"--least {self.least:g}: must be in [0, 1]")
        outputs = (self.out, ".npz"), (self.picture, ".png"), (self.json, "")
        for path, suffix in outputs:
            check_output(path, *self.files, suffix=suffix)
        if self.picture is not None:
            check_drawing()
        table = None if self.markers is None else read_marker_set(self.markers)
        pairs = [
            (read_take(take), read_mocap(mocap))
            for take, mocap in zip(self.files[::2], self.files[1::2], strict=True)
        ]
        with progress_bars() as progress:
            subject = self.subject or self.out.stem
            pairings, refused = pair_session(
                pairs, subject=subject, table=table, least=self.least, progress=progress
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
        out.print(f"wrote {self.out}: {counted(len(pairings), 'clip')}")
        return int(bool(refused))


@dataclass(frozen=True)
class Train:
    """Train a correction method on pairs of Kinect takes and mocap.

    The weights that clean uses by default (pipeline/embedded/learned.npz) come from the
    six pairs files of UI-PRMD and the sessions of two Kinects; training takes a few
    minutes. In addition to the recordings, learned is trained on simulated people.
    """

    out: Annotated[Path, arg(aliases=["-o"])]
    """Model to write (.npz)."""
    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files (.npz), or folders of them; they may be larger than memory."""
    simulated: Skeletons | None = None
    """Train on simulated pairs of this skeleton instead of files."""
    furnished: bool = False
    """Also simulate people behind props and people who handle props."""
    method: LearnedName = "learned"
    """Method to train."""
    preset: PresetName | None = None
    """Train a paper's system instead, with its constants, on the frames that its
    reliability accepts."""
    set: tuple[str, ...] = ()
    """Parameters of --preset or --method, such as clusters=50. An unknown name lists
    those that exist."""
    views: tuple[Path, ...] = ()
    """Sessions of two sensors, or folders of them: NAME.sync.csv beside NAME_A*.csv*
    and NAME_B*.csv*. From these, learned learns how limbs on the far side of the body
    move."""
    people: bool = False
    """Have learned also learn what is specific to each person in the pairs, for clean
    --person."""

    def run(self) -> int:
        """Train the method and write the model."""
        from kinefilter.pipeline.factory import Model, save_model
        from kinefilter.pipeline.lab.simulation import pairs_with_props, simulated_pairs
        from kinefilter.pipeline.lab.training import teach, training_set
        from kinefilter.pipeline.lab.view_sessions import find_sessions, view_pairs

        chosen = None if self.preset else self.method
        config = CleanConfig(method=chosen, preset=self.preset, set=self.set)
        method = config.method or self.method
        if method not in LEARNED:
            raise InputError(
                f"--preset {self.preset} does not learn from pairs; it needs a "
                "database from 'kinefilter database build'"
            )
        if bool(self.pairs) == (self.simulated is not None):
            raise InputError("give either pairs files or --simulated SKELETON")
        if self.furnished and self.simulated is None:
            raise InputError("--furnished requires --simulated SKELETON")
        if method != "learned" and (self.views or self.people):
            raise InputError(f"--views and --people are for learned, not {method}")
        files = in_folders(self.pairs, (".npz",))
        check_output(self.out, *files, suffix=".npz")
        sessions = find_sessions(self.views, None)
        with progress_bars() as progress:
            if self.simulated is None:
                training = training_set(clips_of(files, progress), config)
            else:
                simulated = pairs_with_props if self.furnished else simulated_pairs
                pairs = simulated(self.simulated, progress=progress)
                training = training_set(pairs, config)
            views, source = None, training.source
            if sessions:
                views = training_set(view_pairs(sessions, progress))
                source += f" and two-sensor sessions ({views.source})"
            learner = teach(
                method,
                training,
                views=views,
                people=self.people,
                settings=config.parameters.method,
                progress=progress,
            )
        model = Model(learner, method, training.skeleton, source, self.preset)
        save_model(model, self.out)
        preset = f"{self.preset}, " if self.preset else ""
        out.print(f"wrote {self.out}: {preset}{method}, trained on {source}")
        return 0


@dataclass(frozen=True)
class DatabaseBuild:
    """Build a motion database from mocap."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """Database to write (.npz)."""
    files: Positional[tuple[Path, ...]] = ()
    """Mocap: BVH (.gz too), AMC with its ASF, C3D or TRC of joint centers; or pairs
    files (.npz), whose mocap is used. Folders are searched with their subfolders. The
    files may be larger than memory."""
    skeleton: Skeletons = "kinect_v1"
    """Skeleton of the takes that the database is for."""
    count: int = 2574
    """Approximate number of postures to keep."""
    scripted: bool = False
    """Build from scripted performances instead of files, like the built-in database."""

    def run(self) -> int:
        """Build and write the database."""
        from kinefilter.pipeline.lab import database_build as build

        if self.count < 2:
            raise InputError(f"--count {self.count}: must be at least 2")
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
                database = build.scripted_database(skeleton, progress)
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
        """Print the summary, and the number of postures with each label."""
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
