"""``kinefilter evaluate``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

from tyro.conf import Positional

from kinefilter.characters import InputError

from .terminal import clips_of, keep, out, progress_bars, write_json

_METHODS = (
    "none,butterworth,savgol,one-euro,kalman,low-rank,local-pca,default,exemplar,"
    "full-gp,local-gp,clustered-gp,best"
)


@dataclass(frozen=True)
class Evaluate:
    """Measure correction methods against marker mocap.

    Each method corrects in the place of clean's own, and the clip that comes out is
    compared with the mocap: E, the distance of limb joints relative to the middle of
    the hips; E_std, the same with both sides at standard bone lengths; E_var, the same
    without each joint's constant offset over a clip, which is what one sees as wrong
    motion. Means over frames and joints, then over people, in cm, and against raw.

    default is exactly what clean does, none is clean without any correction. best is a
    Gaussian process over posture, movement and segment lengths, with a part shared by
    all people and a part for people of like proportions.

    With --hide, a limb is hidden in the middle of each clip of PAIRS, and its joints
    are compared with those of the clip cleaned with nothing hidden, and with mocap.
    Beside the methods stand the clip with nothing hidden (seen), and the limb held
    still in the heading frame (hold), turned evenly from where it was last seen to
    where it is seen next (slerp), or smoothed through both (spline).

    With --views, the limbs of a sensor beside a person are compared with those that a
    sensor in front of the person saw at the same time.
    """

    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files for --hide."""
    train: tuple[Path, ...] = ()
    """Pairs files (.npz) to learn from; none for methods that do not learn."""
    test: tuple[Path, ...] = ()
    """Pairs files to test on; default: one person of --train after the other."""
    methods: str = ""
    """Methods, comma-separated; default: none,butterworth,savgol,one-euro,kalman,
    low-rank,local-pca,default,exemplar,full-gp,local-gp,clustered-gp,best, and with
    --hide and --views none,default."""
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
    hide: tuple[str, ...] = ()
    """Limbs to hide, one after the other: left-arm, right-arm, arms, left-leg, legs,
    shins, left-hand (wrist and hand) and so on."""
    gap: tuple[str, ...] = ("55%",)
    """How long a limb is hidden: seconds, or per cent of the clip. Clips that are too
    short are left out and counted."""
    guess: Literal["none", "drift", "hang", "jitter"] = "none"
    """What the sensor says of a hidden limb: nothing, or, as inferred, its last place
    drifting away by 20 cm/s, hanging straight down, or trembling by 5 cm."""
    context: Literal["alone", "repetitions"] = "alone"
    """Whether each clip is a take by itself, or all repetitions of a movement follow
    each other in one take, in which every third has a limb hidden."""
    live: bool = False
    """With --hide: clean frame by frame, without looking ahead."""
    by: Literal["movement", "gap", "person"] | None = None
    """With --hide: a row for each movement, gap or person."""
    every: int = 1
    """With --hide: only every Nth take, to see something sooner."""
    views: tuple[Path, ...] = ()
    """Two takes of the same person, with --sync, or folders and patterns of sessions:
    NAME.sync.csv beside NAME_A*.csv* and NAME_B*.csv*."""
    sync: Path | None = None
    """CSV file milliseconds,A,B: the stamp of either sensor's latest frame."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Evaluate and print."""
        from kinefilter.pipeline.database import PostureDatabase
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.lab.evaluate import as_table, evaluate

        if self.json is not None:
            check_folder(self.json)
            files = (*self.pairs, *self.views, *self.train, *self.test)
            keep(self.json, *files, self.sync, self.database)
        if self.views:
            return self._views()
        if self.hide:
            return self._hide()
        if self.pairs:
            raise InputError("PAIRS are for --hide; give --train or --test, or --hide")
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
                (self.methods or _METHODS).split(","),
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

    def _hide(self) -> int:
        """Hide limbs and print how near to them the clips come."""
        from kinefilter.pipeline.lab import hidden_limbs

        if not self.pairs:
            raise InputError("--hide needs pairs files: evaluate PAIRS --hide left-arm")
        options = hidden_limbs.HiddenLimbs(
            self.hide, self.gap, self.guess, self.context, self.live, self.physics
        )
        methods = (self.methods or "none,default").split(",")
        with progress_bars() as progress:
            records, skipped = hidden_limbs.measure_hidden(
                list(clips_of(self.pairs, progress)),
                methods,
                options,
                every=self.every,
                progress=progress,
            )
        if self.json is not None:
            rows = {
                by or "all": hidden_limbs.summarize(records, by)
                for by in (None, *get_args(hidden_limbs.By))
            }
            figures = {**asdict(options), "skipped": skipped, "rows": rows}
            write_json({**figures, "clips": records}, self.json)
        title = (
            f"hidden for {', '.join(self.gap)}, guess {self.guess}, clips "
            f"{'alone' if self.context == 'alone' else 'among repetitions'}"
            f"{', live' if self.live else ''}; {skipped} too short"
        )
        table = hidden_limbs.summarize(records, self.by)
        out.print(hidden_limbs.as_table(table, title, self.by))
        return 0

    def _views(self) -> int:
        """Print how near the limbs of two sensors are to each other."""
        from kinefilter.pipeline.lab.two_views import (
            as_table,
            compare_views,
            find_sessions,
        )

        sessions = find_sessions(self.views, self.sync)
        methods = (self.methods or "none,default").split(",")
        with progress_bars() as progress:
            figures = compare_views(
                sessions, methods, physics=self.physics, progress=progress
            )
        if self.json is not None:
            write_json(figures, self.json)
        out.print(as_table(figures))
        return 0
