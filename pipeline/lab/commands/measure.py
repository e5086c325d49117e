"""Commands that measure: ``evaluate``, ``reproduce`` and ``bench``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

from tyro.conf import Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import (
    check_output,
    out,
    progress_bars,
    write_json,
)
from kinefilter.pipeline.database import PostureDatabase

from .inputs import clips_of

_METHODS = (
    "none,butterworth,savgol,one-euro,kalman,low-rank,local-pca,default,exemplar,"
    "full-gp,local-gp,clustered-gp,learned"
)


@dataclass(frozen=True)
class Evaluate:
    """Measure correction methods against marker mocap.

    Each method corrects in the place of clean's own, and the clip that comes out is
    compared with the mocap: E, the distance of limb joints relative to the middle of
    the hips; E_std, the same with both sides at standard bone lengths; E_var, the same
    without each joint's constant offset over a clip, which is what one sees as wrong
    motion. Means over frames and joints, then over people, in cm, and against raw.
    Beside them: how many coordinates are within the uncertainty that the clip states
    (within), and how well the distance by which a method moves joints tells those that
    were 7 cm off (found, the area under the ROC curve).

    default is exactly what clean does, with the weights that ship: they were learned on
    the six people of UI-PRMD and on fourteen before two Kinects, so learned tells what
    it is worth to others. none is clean without any correction.

    Presets are the papers' systems, with no stage that a paper does not have. Methods
    in turn are joined, as learned+local-pca, and any may have parameters of its own, as
    local-pca:neighbors=30.

    With --hide, a limb is hidden in the middle of each clip of PAIRS, and its joints
    are compared with those of the clip cleaned with nothing hidden, and with mocap.
    Beside the methods stand the clip with nothing hidden (seen), and the limb held
    still in the heading frame (hold), or turned evenly from where it was last seen to
    where it is seen next (slerp), both of which begin and end where the clip with
    nothing hidden has the limb; and the take cleaned with a smooth curve drawn where
    the limb is hidden (spline).

    With --views, the limbs of a sensor beside a person are compared with those that a
    sensor in front of the person saw at the same time; the method learned then learns
    from --train and from the sessions of other people.
    """

    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files for --hide."""
    train: tuple[Path, ...] = ()
    """Pairs files (.npz) to learn from; none for methods that do not learn. With --hide
    takes and mocap (.bvh) as well: from these, and from the clips of the other people,
    it is learned what hidden limbs mostly do, in place of what ships."""
    test: tuple[Path, ...] = ()
    """Pairs files to test on; default: one person of --train after the other."""
    methods: str = ""
    """Methods, comma-separated; default: none,butterworth,savgol,one-euro,kalman,
    low-rank,local-pca,default,exemplar,full-gp,local-gp,clustered-gp,learned, and with
    --hide and --views none,default."""
    presets: str = ""
    """Papers' systems, comma-separated, or all; they stand beside --methods, if those
    are given."""
    set: tuple[str, ...] = ()
    """Parameters of all methods and presets that have them, such as clusters=50; for
    one of them, --presets liu-2016,liu-2016:clusters=50."""
    protocol: Literal["people", "movements", "repetitions"] = "people"
    """Test on people that were not learned from, on their movements of which nobody's
    was either, or on new repetitions of known people."""
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
    """Test only on every Nth clip, or take, to see something sooner."""
    views: tuple[Path, ...] = ()
    """Two takes of the same person, with --sync, or folders and patterns of sessions:
    NAME.sync.csv beside NAME_A*.csv* and NAME_B*.csv*."""
    sync: Path | None = None
    """CSV file milliseconds,A,B: the stamp of either sensor's latest frame."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Evaluate and print."""
        from kinefilter.pipeline.lab.evaluate import as_table, evaluate

        files = (*self.pairs, *self.views, *self.train, *self.test)
        check_output(self.json, *files, self.sync, self.database)
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
            train = list(clips_of(self.train, progress))
            test = list(clips_of(self.test, progress))
            figures = evaluate(
                train,
                test,
                _listed(self.methods or ("" if self.presets else _METHODS)),
                presets=_listed(self.presets),
                assigned=self.set,
                protocol=self.protocol,
                physics=self.physics,
                ablation=self.ablation,
                database=database,
                every=self.every,
                progress=progress,
            )
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
        usual = "" if self.presets else "none,default"
        with progress_bars() as progress:
            records, skipped = hidden_limbs.measure_hidden(
                list(clips_of(self.pairs, progress)),
                _listed(self.methods or usual),
                options,
                recordings=self.train,
                presets=_listed(self.presets),
                assigned=self.set,
                every=self.every,
                progress=progress,
            )
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
                sessions,
                methods,
                train=list(clips_of(self.train, progress)),
                physics=self.physics,
                progress=progress,
            )
        write_json(figures, self.json)
        out.print(as_table(figures))
        return 0


def _listed(names: str) -> list[str]:
    return names.split(",") if names else []


@dataclass(frozen=True)
class Reproduce:
    """Measure again what README and the papers say: a table and a plot for each study.

    Studies of takes and of marker mocap: cleaned-takes, methods-new-people,
    methods-known-people, presets, failures, reliability; of speed: speed,
    million-postures; of the papers, on simulated takes: shum-tables-1-2, shum-table-3,
    shum-table-4, shum-figure-8, liu-figure-3, liu-figure-7, liu-figure-8, liu-table-2,
    liu-table-3, chiang-figure-5, chiang-figure-7, wang-table-1; on recorded ones too:
    liu-table-4, liu-table-5, chiang-table-1, chiang-tables-2-3, wang-figure-1; of the
    virtual Kinect's trackers (Liu 2016, section 5.4): tracker-errors, tracker-lessons.
    What people rate, as in Shum's and Liu's figures 6, is for 'kinefilter rate'.

    With --all, every study and picture is made and every figure of README compared with
    what was measured, in over an hour on two cores; the exit code is 1 if one
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
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: expected 0 or more")
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
                continue
            with progress_bars() as progress:
                options = studies.Options(self.seed, data, progress)
                study = studies.reproduce(name, options, quick=self.quick)
            written = studies.write_study(name, study, folder)
            out.print(studies.as_table(study))
            out.print(f"wrote {' and '.join(map(str, written))}\n")
            studies.note_made(name, folder, stamp)
        if self.all is None:
            return 0
        with progress_bars() as progress:
            for line in studies.make_pictures(folder, data=data, progress=progress):
                out.print(line)
        claims, real = studies.claims, data is not None
        found = claims.judge(folder, recordings=real, quick=self.quick)
        verdicts = claims.write_verdicts(found, folder)
        out.print(claims.verdicts_table(found))
        out.print(f"wrote {verdicts}")
        return int(any(verdict.held is False for verdict in found))


@dataclass(frozen=True)
class Bench:
    """Time every stage frame by frame, a live frame in all, and whole takes."""

    take: Path | None = None
    """Take to time on; default: the sample that comes with kinefilter."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Time and print."""
        from kinefilter.pipeline.lab.bench import as_table, bench

        check_output(self.json, self.take)
        figures = bench(self.take)
        write_json(figures, self.json)
        out.print(as_table(figures))
        return 0
