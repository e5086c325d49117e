"""Commands that measure: ``evaluate``, ``reproduce`` and ``bench``."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from rich.table import Table
from tyro.conf import Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import (
    check_output,
    out,
    progress_bars,
    write_json,
)
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.formats.files import make_folder

from . import clips_of

_METHODS = (
    "none,butterworth,savgol,one-euro,kalman,low-rank,local-pca,default,exemplar,"
    "full-gp,local-gp,clustered-gp,learned"
)
_FOR_HIDING = ("gap", "guess", "context", "by")
_FOR_METHODS = ("test", "protocol", "database", "mocap_database")
_UNUSED = {
    "evaluate without --hide": (*_FOR_HIDING, "sync"),
    "--hide": (*_FOR_METHODS, "sync"),
    "--views": (*_FOR_METHODS, *_FOR_HIDING, "hide", "presets", "set", "every", "live"),
}
"""By mode, the options that have no effect in it."""


@dataclass(frozen=True)
class Evaluate:
    """Measure correction methods against marker mocap.

    Each method replaces clean's own correction, and the resulting clip is compared with
    the mocap. E is the distance of limb joints from the mocap, relative to the middle
    of the hips; E_std the same with both sides scaled to standard bone lengths; E_var
    the same without each joint's constant offset over a clip, which leaves what a
    viewer notices as wrong motion. All are in cm: means over frames and joints, then
    over people, and relative to the raw take. Further columns: hips, the error of their
    velocity [cm/s]; jitter [m/s³]; ms, the method's time per frame; within, the share
    of coordinates within the uncertainty that the clip states, and below 1.96 times it;
    and found, how well the distance by which a method moves a joint detects errors
    above 7 cm (area under the ROC curve). With --json, there is also p95, the 95th
    percentile of E's distances [cm].

    default is exactly what clean does, with the weights that ship. They were trained on
    the six people of UI-PRMD and on fourteen people recorded by two Kinects; learned is
    trained anew and therefore shows how well they work on others. none is clean without
    any correction.

    Presets are the papers' systems, without the stages that a paper lacks. Methods can
    be chained, as in learned+local-pca, and can have parameters of their own, as in
    local-pca:neighbors=30, or local-gp:temporal=0 without a term of its energy.

    With --hide, a limb is hidden in the middle of each clip of PAIRS, and its joints
    are compared with the clip cleaned with nothing hidden, and with mocap. For
    reference, the table also has the clip with nothing hidden (seen); the limb held
    still in the heading frame (hold) or turned evenly from where it was last seen to
    where it reappears (slerp), both starting and ending on the clip with nothing
    hidden; and the take cleaned with a smooth curve (spline) for the hidden limb.

    With --views, the limbs from a sensor beside a person are compared with what a
    sensor in front of the person saw at the same time. Here learned is trained on the
    files of --train and on the sessions of other people.
    """

    pairs: Positional[tuple[Path, ...]] = ()
    """Pairs files for --hide."""
    train: tuple[Path, ...] = ()
    """Pairs files (.npz) to train on; none for methods that are not trained. With
    --hide also takes and mocap (.bvh): the prior for hidden limbs is trained on these
    and on the clips of the other people, instead of the one that ships."""
    test: tuple[Path, ...] = ()
    """Pairs files to test on; default: each person of --train in turn."""
    methods: str = ""
    """Methods, comma-separated; default: none,butterworth,savgol,one-euro,kalman,
    low-rank,local-pca,default,exemplar,full-gp,local-gp,clustered-gp,learned, or
    none,default with --hide and --views."""
    presets: str = ""
    """The papers' systems, comma-separated, or all. Methods are measured beside them
    only if --methods is given."""
    set: tuple[str, ...] = ()
    """Parameters of all methods and presets that have them, such as clusters=50. To set
    them for one only: --presets liu-2016,liu-2016:clusters=50."""
    protocol: Literal["people", "movements", "repetitions"] = "people"
    """Test on people who are not in the training data; on people and movements neither
    of which is in it; or on new repetitions by the people in it."""
    physics: bool = True
    """Pull the simulated character through the corrected motion, as clean does."""
    database: Path | None = None
    """Motion database (.npz) for methods that need one; default: the built-in one,
    which the method default always uses."""
    mocap_database: bool = False
    """Use the mocap of the training clips as the motion database."""
    hide: tuple[str, ...] = ()
    """Limbs to hide, one at a time, comma-separated: left-arm, right-arm, arms,
    left-leg, legs, shins, left-hand (wrist and hand) and so on."""
    gap: tuple[str, ...] = ("55%",)
    """How long a limb is hidden: seconds, or a percentage of the clip. Clips that are
    too short are skipped and counted."""
    guess: Literal["none", "drift", "hang", "jitter"] = "none"
    """What the sensor reports for a hidden limb: nothing, or, as inferred, its last
    position drifting away at 20 cm/s, hanging straight down, or jittering by 5 cm."""
    context: Literal["alone", "repetitions"] = "alone"
    """Treat each clip as a take of its own, or join all repetitions of a movement into
    one take and hide the limb in every third."""
    live: bool = False
    """Clean frame by frame, without looking ahead, as 'kinefilter live' does."""
    by: Literal["movement", "gap", "person"] | None = None
    """With --hide: print a row for each movement, gap or person."""
    every: int = 1
    """Test only on every Nth clip or take, for a quicker estimate."""
    views: tuple[Path, ...] = ()
    """Two takes of the same person, with --sync; or folders or patterns of sessions:
    NAME.sync.csv beside NAME_A*.csv* and NAME_B*.csv*."""
    sync: Path | None = None
    """CSV file milliseconds,A,B: the time stamp of each sensor's latest frame."""
    json: Path | None = None
    """Also write the figures to this JSON file."""

    def run(self) -> int:
        """Measure and print a table."""
        files = (*self.pairs, *self.views, *self.train, *self.test)
        check_output(self.json, *files, self.sync, self.database)
        mode, measure = "evaluate without --hide", self._methods
        if self.views:
            mode, measure = "--views", self._views
        elif self.hide:
            mode, measure = "--hide", self._hide
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _UNUSED[mode] and value != field.default:
                option = "--" + field.name.replace("_", "-")
                raise InputError(f"{option} does not apply to {mode}; leave it out")
        figures, table = measure()
        write_json(figures, self.json)
        out.print(table)
        return 0

    def _methods(self) -> tuple[dict[str, Any], Table]:
        from kinefilter.pipeline.lab.evaluate import as_table, evaluate

        if self.pairs:
            raise InputError("PAIRS are for --hide; add it, or use --train and --test")
        if self.mocap_database and self.database is not None:
            raise InputError("give either --database or --mocap-database")
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
                database=database,
                live=self.live,
                every=self.every,
                progress=progress,
            )
        return figures, as_table(figures)

    def _hide(self) -> tuple[dict[str, Any], Table]:
        from kinefilter.pipeline.lab import hidden_limb_evaluation as hidden_limbs

        if not self.pairs:
            raise InputError(
                "--hide needs pairs files; put them first, as in evaluate PAIRS --hide "
                "left-arm, or what follows --hide is taken for limbs"
            )
        options = hidden_limbs.HiddenLimbs(
            tuple(_listed(",".join(self.hide))),
            tuple(_listed(",".join(self.gap))),
            *(self.guess, self.context, self.live, self.physics),
        )
        default = "" if self.presets else "none,default"
        with progress_bars() as progress:
            records, skipped = hidden_limbs.measure_hidden(
                list(clips_of(self.pairs, progress)),
                _listed(self.methods or default),
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
        figures = asdict(options) | {"skipped": skipped, "rows": rows, "clips": records}
        gaps = ", ".join(g if g[-1] == "%" else f"{g} s" for g in options.gaps)
        title = (
            f"hidden for {gaps}, guess {self.guess}, clips "
            f"{'alone' if self.context == 'alone' else 'among repetitions'}"
            f"{', live' if self.live else ''}; {skipped} too short"
        )
        summary = hidden_limbs.summarize(records, self.by)
        return figures, hidden_limbs.as_table(summary, title, self.by)

    def _views(self) -> tuple[dict[str, Any], Table]:
        from kinefilter.pipeline.lab import two_views
        from kinefilter.pipeline.lab.view_sessions import find_sessions

        sessions = find_sessions(self.views, self.sync)
        with progress_bars() as progress:
            figures = two_views.compare_views(
                sessions,
                _listed(self.methods or "none,default"),
                train=list(clips_of(self.train, progress)),
                physics=self.physics,
                progress=progress,
            )
        return figures, two_views.as_table(figures)


def _listed(names: str) -> list[str]:
    return names.split(",") if names else []


@dataclass(frozen=True)
class Reproduce:
    """Measure again what README and the papers report: a table and a plot per study.

    Studies of takes and of marker mocap: cleaned-takes, methods-new-people,
    methods-known-people, presets, failures, reliability. Things that are held:
    held-box, dribbled-ball; that are sat on: chairs. Speed: speed, million-postures.
    The papers on simulated takes: shum-tables-1-2, shum-table-3, shum-table-4,
    shum-figure-8, liu-figure-3, liu-figure-7, liu-figure-8, liu-table-2, liu-table-3,
    chiang-figure-5, chiang-figure-7, wang-table-1; on recorded takes as well:
    liu-table-4, liu-table-5, chiang-table-1, chiang-tables-2-3, wang-figure-1. Trackers
    of the virtual Kinect (Liu 2016, section 5.4): tracker-errors, tracker-lessons. To
    have people rate clips, as in figure 6 of Shum and of Liu, use kinefilter rate.

    Figures that README states are compared with the measured ones; the exit code is 1
    if one does not hold. With --all, every study and animation is made, in over an hour
    on two cores. Running it again makes only what is missing or was made with other
    code or recordings. Needs pip install "kinefilter[reproduce]"; animations also need
    OpenGL.
    """

    studies: Positional[tuple[str, ...]] = ()
    """Names of studies."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Folder for STUDY.csv and STUDY.png; created if missing."""
    all: Path | None = None
    """Make everything in this folder, including claims.csv, README's figures beside the
    measured ones."""
    data: Path | None = None
    """Folder of recordings; default: ../shared/data if it exists. It contains takes,
    takes/*/*.csv or .csv.gz (*_failure have gross failures, those in precog16 are
    punches and kicks), and pairs files of one person each, ui-prmd/s*.npz, in the
    format of 'simulate --pairs', with clips named by movement, m01_... Without
    recordings, people are simulated, and what needs recordings is not measured."""
    seed: int = 0
    """Seed of simulated people, performances and sensor errors."""
    quick: bool = False
    """Trial run on a small part of everything; its figures mean little."""

    def run(self) -> int:
        """Run the studies, and write and print their results."""
        from kinefilter.pipeline.lab import studies

        folder = self.out if self.all is None else self.all
        two_folders = self.all is not None and self.out is not None
        if folder is None or two_folders or bool(self.studies) != (self.all is None):
            raise InputError("give either --all FOLDER, or studies and -o FOLDER")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: must be at least 0")
        names = self.studies if self.all is None else tuple(studies.STUDIES)
        studies.check_names(names)
        studies.study.check_drawing()
        data = studies.recordings_folder(self.data)
        make_folder(folder)
        stamp = studies.fingerprint(data, seed=self.seed, quick=self.quick)
        for name in names:
            if self.all is not None and studies.is_up_to_date(name, folder, stamp):
                out.print(f"{folder / name}.csv is up to date\n")
                continue
            with progress_bars() as progress:
                options = studies.Options(self.seed, data, progress)
                study = studies.reproduce(name, options, quick=self.quick)
            written = studies.study.write_study(name, study, folder)
            out.print(studies.as_table(study))
            out.print(f"wrote {' and '.join(map(str, written))}\n")
            studies.record_fingerprint(name, folder, stamp)
        claims, recorded = studies.claims, data is not None
        verdicts = claims.judge(folder, names, recordings=recorded, quick=self.quick)
        if verdicts:
            out.print(claims.verdicts_table(verdicts))
        if self.all is not None:
            with progress_bars() as progress:
                pictures = studies.study.make_pictures
                for line in pictures(folder, data=data, progress=progress):
                    out.print(line)
            out.print(f"wrote {claims.write_verdicts(verdicts, folder)}")
        return int(any(verdict.held is False for verdict in verdicts))


@dataclass(frozen=True)
class Bench:
    """Time each stage per frame, a complete live frame, and whole takes."""

    take: Path | None = None
    """Take to time with; default: the sample that ships with kinefilter."""
    json: Path | None = None
    """Also write the figures to this JSON file."""

    def run(self) -> int:
        """Measure the times and print a table."""
        from kinefilter.pipeline.lab.bench import as_table, bench

        check_output(self.json, self.take)
        figures = bench(self.take)
        write_json(figures, self.json)
        out.print(as_table(figures))
        return 0
