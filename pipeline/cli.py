"""The command line: parses and prints; everything else is in the package."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich import progress as rich_progress
from rich.console import Console
from tyro.conf import (
    OmitArgPrefixes,
    OmitSubcommandPrefixes,
    Positional,
    arg,
    subcommand,
)

from kinefilter.characters import SKELETONS, InputError, State

from .config import CleanConfig, LearnedMethod
from .progress import Progress

if TYPE_CHECKING:
    from .training import PairedTake

__all__ = ["main"]

_out = Console(soft_wrap=True, highlight=False)
_err = Console(stderr=True, soft_wrap=True, highlight=False)

Skeletons = Literal["kinect_v1", "kinect_v2"]
Formats = Literal["kinefilter", "kinect-v2", "kinect-v1"]


@dataclass(frozen=True)
class Clean:
    """Clean a Kinect take and write it as an animation clip."""

    take: Positional[Path]
    """Recording: kinefilter CSV, Kinect v2 CSV or Kinect v1 text; .gz too."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Clip to write; the extension decides: .usda .usdc .usd .bvh .csv .npz."""
    config: OmitArgPrefixes[CleanConfig] = field(default_factory=CleanConfig)
    format: Formats | None = None
    """Layout of the take; default: detected from its content."""
    json: Path | None = None
    """Write the printed figures to this file too."""

    def run(self) -> int:
        """Clean, write, print."""
        from .formats import check_folder, check_writable, read_take, write_clip
        from .run import clean
        from .summary import as_json, as_tables

        check_writable(self.out)
        used = (self.take, self.config.database, self.config.model)
        _keep(self.out, *used)
        if self.json is not None:
            check_folder(self.json)
            _keep(self.json, *used, self.out)
        take = read_take(self.take, format=self.format)
        with _progress() as progress:
            result = clean(take, self.config, progress=progress)
        write_clip(result.clip, self.out)
        if self.json is not None:
            _write_json(as_json(result), self.json)
        _out.print(as_tables(result))
        _out.print(f"wrote {self.out}")
        return 0


@dataclass(frozen=True)
class DatabaseBuild:
    """Build a motion database from mocap."""

    files: Positional[tuple[Path, ...]]
    """BVH files (.gz too) with the joint names of the cgspeed CMU conversion, or pairs
    files (.npz), of which the mocap is taken."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Database to write (.npz)."""
    skeleton: Skeletons = "kinect_v1"
    """Skeleton of the takes that it is for."""
    count: int = 2574
    """About how many postures to keep."""

    def run(self) -> int:
        """Build and write."""
        from .formats import check_folder
        from .library import database_from_bvh, database_from_pairs

        if self.out.suffix != ".npz":
            raise InputError(f"{self.out}: a database is an .npz file; name it so")
        if self.count < 2:
            raise InputError(f"--count {self.count}: a database needs two postures")
        check_folder(self.out)
        _keep(self.out, *self.files)
        skeleton = SKELETONS[self.skeleton]
        paired = [file for file in self.files if file.suffix == ".npz"]
        if paired and len(paired) < len(self.files):
            raise InputError(f"{paired[0]}: give BVH files or pairs files, not both")
        with _progress() as progress:
            if paired:
                pairs = _read_all(paired)
                if (found := pairs[0].take.skeleton) != skeleton:
                    raise InputError(
                        f"{paired[0]}: pairs of {found.name}; add --skeleton "
                        f"{found.name}"
                    )
                database = database_from_pairs(
                    pairs, count=self.count, progress=progress
                )
            else:
                database = database_from_bvh(
                    self.files, skeleton, count=self.count, progress=progress
                )
        database.save(self.out)
        _out.print(f"wrote {self.out}: {database.summary}")
        return 0


@dataclass(frozen=True)
class DatabaseInfo:
    """Say what a motion database holds."""

    file: Positional[Path]
    """Database (.npz)."""

    def run(self) -> int:
        """Read and print."""
        from .database import PostureDatabase

        database = PostureDatabase.load(self.file)
        _out.print(f"{self.file}: {database.summary}")
        for label, count in sorted(Counter(database.labels.tolist()).items()):
            _out.print(f"{count:6d} {label}", markup=False)
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


@dataclass(frozen=True)
class Train:
    """Teach a correction method from pairs of Kinect and mocap."""

    pairs: Positional[tuple[Path, ...]]
    """Pairs files (.npz)."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Model to write (.npz)."""
    method: LearnedMethod = "best"
    """What to teach."""

    def run(self) -> int:
        """Learn and write."""
        from .correct.methods import LEARNED
        from .formats import check_folder
        from .models import Model, save_model
        from .training import training_set

        if self.out.suffix != ".npz":
            raise InputError(f"{self.out}: a model is an .npz file; name it so")
        check_folder(self.out)
        _keep(self.out, *self.pairs)
        pairs = _read_all(self.pairs)
        with _progress() as progress:
            lessons = training_set(pairs, progress=progress)
            learner = LEARNED[self.method](lessons.skeleton)
            learner.fit(lessons, progress=progress)
        model = Model(learner, self.method, lessons.skeleton, lessons.source)
        save_model(model, self.out)
        _out.print(f"wrote {self.out}: {self.method}, learned from {lessons.source}")
        return 0


@dataclass(frozen=True)
class Evaluate:
    """Measure correction methods against marker mocap."""

    train: tuple[Path, ...]
    """Pairs files (.npz) to learn from."""
    test: tuple[Path, ...] = ()
    """Pairs files to test on; default: one person of --train after the other."""
    methods: str = (
        "butterworth,savgol,one-euro,kalman,low-rank,local-pca,"
        "exemplar,full-gp,local-gp,clustered-gp,best"
    )
    """Methods, comma-separated."""
    protocol: Literal["people", "repetitions"] = "people"
    """Test on people, or on repetitions of known people, that were not learned from."""
    physics: bool = False
    """Send what the methods give through the simulated character too."""
    ablation: bool = False
    """Also measure methods without a part of them: local-gp without terms of its
    energy (Liu 2016, Table 5), Shum's methods A and B beside local-pca."""
    database: Path | None = None
    """Motion database (.npz); default: the embedded."""
    mocap_database: bool = False
    """Take the mocap of the clips that are learned from for the motion database."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Evaluate and print."""
        from .database import PostureDatabase
        from .evaluate import as_table, evaluate
        from .formats import check_folder

        if self.json is not None:
            check_folder(self.json)
            _keep(self.json, *self.train, *self.test, self.database)
        if self.mocap_database and self.database is not None:
            raise InputError("give --database or --mocap-database, not both")
        database: PostureDatabase | Literal["mocap"] | None = None
        if self.mocap_database:
            database = "mocap"
        elif self.database is not None:
            database = PostureDatabase.load(self.database)
        train, test = _read_all(self.train), _read_all(self.test)
        with _progress() as progress:
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
            _write_json(figures, self.json)
        _out.print(as_table(figures))
        return 0


def _read_all(files: Sequence[Path]) -> list[PairedTake]:
    from .training import read_pairs

    return [pair for file in files for pair in read_pairs(file)]


@dataclass(frozen=True)
class Simulate:
    """Let a virtual Kinect record a scripted motion, of which the truth is known."""

    scene: Positional[str]
    """basic, box, flip_chart, basketball, chair, office, or an MJCF file (.xml)."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Take to write (.csv)."""
    motion: str = "walk"
    """What is done, such as walk, deep_squat, tai_chi or lift_box."""
    sensor: Literal["v1", "v2", "azure"] = "v2"
    """Which Kinect looks."""
    skeleton: Skeletons | None = None
    """Skeleton of the take; default: the sensor's."""
    seed: int = 0
    """Draws the person, the performance and the errors: same seed, same bytes."""
    truth: Path | None = None
    """Write what really happened to this file too (.csv)."""
    pairs: Path | None = None
    """Write take and truth as a pairs file too (.npz), to train and evaluate with."""

    def run(self) -> int:
        """Simulate and write."""
        from .formats import check_folder, write_take_csv
        from .simulate import simulate, truth_of, write_pairs

        for path, suffix in (
            (self.out, ".csv"),
            (self.truth, ".csv"),
            (self.pairs, ".npz"),
        ):
            if path is not None and path.suffix != suffix:
                raise InputError(f"{path}: expected a name that ends in {suffix}")
            if path is not None:
                check_folder(path)
        _keep(self.out, self.truth, self.pairs)
        pair = simulate(
            self.scene,
            self.motion,
            sensor=self.sensor,
            skeleton=self.skeleton,
            seed=self.seed,
        )
        write_take_csv(pair.take, self.out)
        if self.truth is not None:
            write_take_csv(truth_of(pair), self.truth)
        if self.pairs is not None:
            write_pairs([pair], self.pairs)
        tracked = (pair.take.state == State.TRACKED).mean()
        _out.print(f"wrote {self.out}: {len(pair.take)} frames, {tracked:.0%} tracked")
        return 0


@dataclass(frozen=True)
class Bench:
    """Time every stage, frame by frame as a live user would run it."""

    take: Path | None = None
    """Take to time on; default: the sample that comes with kinefilter."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Time and print."""
        from .bench import as_table, bench
        from .formats import check_folder

        if self.json is not None:
            check_folder(self.json)
            _keep(self.json, self.take)
        figures = bench(self.take)
        if self.json is not None:
            _write_json(figures, self.json)
        _out.print(as_table(figures))
        return 0


Command = (
    Annotated[Clean, subcommand("clean")]
    | Annotated[Database, subcommand("database")]
    | Annotated[Train, subcommand("train")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Simulate, subcommand("simulate")]
    | Annotated[Bench, subcommand("bench")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0: done. 2: the input or the command was wrong; nothing was written.
    """
    try:
        command = tyro.cli(
            Command,
            prog="kinefilter",
            description="Turn noisy Kinect takes into clips that animators ship.",
            args=arguments,
        )
        return command.run()
    except InputError as error:
        _err.print(f"kinefilter: {error}", markup=False)
        return 2


def _keep(written: Path, *others: Path | None) -> None:
    """Raise an InputError if a file to write is one that must not be lost."""
    for other in others:
        if other is not None and written.resolve() == other.resolve():
            raise InputError(
                f"{written}: would overwrite {other}; give another name to write to"
            )


@contextmanager
def _progress() -> Iterator[Progress]:
    columns = (
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.MofNCompleteColumn(),
        rich_progress.TimeRemainingColumn(),
    )
    with rich_progress.Progress(
        *columns, console=_err, transient=True, disable=not _err.is_terminal
    ) as bars:
        yield lambda stage, count: bars.track(range(count), count, description=stage)


def _write_json(figures: object, path: Path) -> None:
    from .formats import atomic_path

    with atomic_path(path) as temporary:
        text = json.dumps(figures, indent=2, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
