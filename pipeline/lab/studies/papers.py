"""Tables of the papers: Shum 2013, I, II; Liu 2016, 3; Chiang 2017, 2, 3; Wang, I.

Each beside the paper's own figures. Systems are the presets, each with its constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, Observation
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.methods.low_rank import LowRank
from kinefilter.pipeline.lab.systems import School, System, systems_of
from kinefilter.pipeline.lab.training import observed, standard_truth
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.presets import PRESETS
from kinefilter.pipeline.progress import over

from .study import Cell, Options, Panel, Series, Study, series_of
from .takes import CLASSES, first_person, performed_by, study_takes

_LIU_3 = {
    "cross_arms": (12.5, 9.8, 7.2, 7.9, 7.4),
    "bend": (13.7, 9.5, 8.4, 9.2, 8.7),
    "tai_chi": (14.5, 10.2, 7.5, 8.0, 7.4),
    "wave": (12.5, 8.8, 6.5, 6.9, 6.6),
}
"""Errors [cm] of Kinect and of the presets in their order."""
_LIU_SYSTEMS = ("shen-2012", "zhou-2014", "liu-2016:adapt=false", "liu-2016")
_LIU_MS = (None, None, 37.0, None, 29.0)  # a frame: full, and local processes

_CHIANG_2_3 = {
    "deep_breathing": (
        (10.22, 4.91, 1.46, 0.14, 1.79, 2.46),
        (13.82, 6.49, 3.10, 0.21, 3.48, 2.91),
    ),
    "clasp_and_spread": (
        (9.21, 8.18, 1.76, 0.13, 1.95, 3.21),
        (13.12, 11.89, 6.23, 0.17, 4.26, 7.58),
    ),
    "overhead_pumping": (
        (8.94, 7.36, 3.38, 0.21, 4.34, 5.58),
        (13.57, 11.54, 7.45, 0.24, 7.10, 7.98),
    ),
    "push_down_pumping": (
        (8.38, 6.27, 2.70, 0.18, 2.72, 5.21),
        (13.79, 10.13, 6.76, 0.35, 4.01, 7.68),
    ),
}
"""Errors [cm] of Kinect, of Liu's method and of the paper's, of its shoulders, elbows
and wrists, for all samples and for the unreliable ones."""
_CHIANG_SYSTEMS = ("liu-2016:adapt=false", "chiang-2017")
_SAMPLES = ("all", "unreliable")
_ARM = ("Shoulder", "Elbow", "Wrist")

_WANG_1 = {241: 0.6190, 463: 0.8001, 1245: 1.1470, 1423: 1.3740}
"""Seconds by frames."""

_SHUM_1 = {
    "locomotion": (("walk", "run", "march"), 8.1, 15.27),
    "object handling": (("pick_up", "carry"), 8.9, 11.80),
    "upper body movement": (("point", "scratch"), 17.8, 6.6),
    "boxing": (("punch", "kick"), 11.8, 13.7),
    "sword fighting": (("swing", "dodge"), 16.3, 13.4),
}
"""The database's classes: motions, and standard deviations [cm] above and below."""
_SHUM_2 = {
    "basic": (13.4, 9.24),
    "box": (12.26, 6.39),
    "flip_chart": (13.24, 7.38),
    "basketball": (11.81, 4.18),
    "chair": (7.87, 11.86),
    "office": (13.23, 9.51),
}
"""The testing data's scenes: standard deviations [cm] above and below."""


class _Trial:
    """Takes that a group of systems learns from, and takes of the same motions again.

    By people whom nobody learned from (``new``), and in other performances by those who
    were (``known``), as the papers have it.
    """

    def __init__(
        self,
        options: Options,
        motions: Sequence[str],
        people: int,
        *,
        sensor: str,
        standard: bool,
    ) -> None:
        first, new = (first_person(options.seed, learners=who) for who in (True, False))
        progress = options.progress

        def record(who: range, *, again: bool = False) -> list[PairedTake]:
            return performed_by(
                who, motions, sensor=sensor, again=again, progress=progress
            )

        lessons = record(range(first, first + people))
        few = max(people // 4, 1)
        self.skeleton = lessons[0].take.skeleton
        accuracy = Accuracy(self.skeleton)
        self.away = accuracy.standardized if standard else accuracy.distances
        self.tests = {
            "new": record(range(new, new + few)),
            "known": record(range(first, first + few), again=True),
        }
        self._school = School(
            lessons,
            self.skeleton,
            people=False,
            database=builtin_database(self.skeleton),
            progress=progress,
        )

    def taught(self, names: Sequence[str]) -> list[tuple[System, Corrector]]:
        """Return presets, and what corrects in them."""
        systems = systems_of((), names)
        return [(system, self._school.corrector(system)) for system in systems]

    def distances(
        self, pair: PairedTake, system: System, corrector: Corrector
    ) -> Array:
        """Return how far limb joints are from the truth [m], (T, 12)."""
        cleaner = Cleaner(system.config, corrector=corrector).until("correct")
        return self.away(cleaner.whole(pair.take).positions, pair.truth)


def liu_table_3(options: Options, *, people: int = 8, motions: int = 4) -> Study:
    """Compare local processes with exemplars and with full ones, motion by motion.

    The paper says nothing of who was tested, and times whole systems. A quarter as many
    people are tested as perform for the methods to learn.
    """
    names = [*_LIU_3][:motions]
    trial = _Trial(options, names, people, sensor="v2", standard=False)
    systems = trial.taught(_LIU_SYSTEMS)
    rows: list[tuple[Cell, ...]] = []
    seconds, frames = np.zeros(len(systems)), 0
    for group, pairs in trial.tests.items():
        by_motion: dict[str, list[list[Array]]] = {name: [] for name in names}
        for k, pair in enumerate(over(pairs, f"correct ({group})", options.progress)):
            raw = trial.away(pair.take.positions, pair.truth)
            found, frames = [raw], frames + len(pair.take)
            for n, (system, corrector) in enumerate(systems):
                began = perf_counter()
                found.append(trial.distances(pair, system, corrector))
                seconds[n] += perf_counter() - began
            by_motion[names[k % len(names)]].append(found)
        for name, takes in by_motion.items():
            errors = [_cm(*parts) for parts in zip(*takes, strict=True)]
            rows.append((name, group, *errors))
    rows += [(name, "paper", *_LIU_3[name]) for name in names]
    labels = ("kinect", "shen", "zhou", "liu, offline", "liu, incremental")
    bars = series_of(
        [(f"{row[0]}, {row[1]}", *row[2:]) for row in rows],
        {label: k for k, label in enumerate(labels, 1)},
        kind="bars",
    )
    rows.append(("ms a frame", "all", None, *(1e3 * seconds / frames)))
    rows.append(("ms a frame", "paper", *_LIU_MS))
    who = ("kinect", "shen_2012", "zhou_2014", "liu_offline", "liu_incremental")
    return Study(
        title="Exemplars, full and local processes (Liu 2016, Table 3 and section 5.3)",
        columns=("motion", "people", *(f"{name}_cm" for name in who)),
        rows=rows,
        panels=[Panel("motion and people", "error, cm", bars)],
    )


def chiang_tables_2_3(options: Options, *, people: int = 16, motions: int = 4) -> Study:
    """Compare a clustered process with local ones, on all samples and unreliable ones.

    Those are frames in which a joint of the arms, or between the shoulders, scores 0.7
    or less, as the paper has it; errors are those of the arms' joints, all bodies at
    standard lengths. Table 3 has them joint by joint. A quarter as many people are
    tested as the methods learn from.
    """
    names = [*_CHIANG_2_3][:motions]
    # A v2's thumbs leave too few frames with every joint reliable.
    trial = _Trial(options, names, people, sensor="v1", standard=True)
    systems = trial.taught(_CHIANG_SYSTEMS)
    rows: list[tuple[Cell, ...]] = []
    for group, pairs in trial.tests.items():
        by_motion: dict[str, list[tuple[Flags, list[Array]]]] = {n: [] for n in names}
        for k, pair in enumerate(over(pairs, f"correct ({group})", options.progress)):
            found = [trial.away(pair.take.positions, pair.truth)]
            found += [trial.distances(pair, *system) for system in systems]
            doubtful = _unreliable(pair, trial.skeleton)
            by_motion[names[k % len(names)]].append((doubtful, found))
        for name, takes in by_motion.items():
            for samples in _SAMPLES:
                some = [d if samples == "unreliable" else d | True for d, _ in takes]
                parts = zip(*(found for _, found in takes), strict=True)
                arms = [
                    np.concatenate([a[k, :6] for k, a in zip(some, part, strict=True)])
                    for part in parts
                ]
                by_joint = [arms[-1][:, 2 * k : 2 * k + 2] for k in range(3)]
                rows.append((name, samples, group, *map(_cm, (*arms, *by_joint))))
    for name in names:
        for samples, paper in zip(_SAMPLES, _CHIANG_2_3[name], strict=True):
            rows.append((name, samples, "paper", *paper))
    bars = series_of(
        [(f"{row[0]}, {row[2]}", *row[3:]) for row in rows if row[1] == "all"],
        {"kinect": 1, "liu-2016": 2, "chiang-2017": 3},
        kind="bars",
    )
    errors = ("kinect", "liu", "chiang", "shoulders", "elbows", "wrists")
    return Study(
        title="Clustered and local processes on four exercises (Chiang 2017, 2 and 3)",
        columns=("exercise", "samples", "people", *(f"{name}_cm" for name in errors)),
        rows=rows,
        panels=[Panel("exercise and people, all samples", "error, cm", bars)],
    )


def _unreliable(pair: PairedTake, skeleton: Skeleton) -> Flags:
    """Return the frames in which Chiang's reliability doubts the upper body, (T,)."""
    preset = PRESETS["chiang-2017"]
    draft = observed(pair, CleanConfig(preset="chiang-2017"))
    names = [part + side for part in _ARM for side in ("Left", "Right")]
    joints = [skeleton.girdle, *map(skeleton.index, names)]
    least = preset.settings["smallest_reliability"]
    return np.asarray((draft.reliability[:, joints] <= least).any(axis=1))


def wang_table_1(options: Options, *, sizes: int = 4) -> Study:
    """Time the recovery of takes of the paper's lengths; their singular values.

    People dance one after the other, as recorded by a virtual Kinect v2; lengths are
    those of the paper's takes. The paper plots the singular values of its dance
    (Figure 1) and reads a rank of 5 off them.
    """
    first, system = first_person(options.seed), systems_of((), ["wang-low-rank"])[0]
    lengths, drafts = [*_WANG_1][:sizes], list[Array]()
    while sum(map(len, drafts)) < max(lengths):
        someone = range(first + len(drafts), first + len(drafts) + 1)
        (pair,) = performed_by(someone, ["dance"], progress=options.progress)
        drafts.append(observed(pair, system.config).standard)
    dance, skeleton = np.concatenate(drafts), pair.take.skeleton
    rows: list[tuple[Cell, ...]] = []
    for count in lengths:
        method = LowRank(skeleton, **system.config.parameters.method)
        weights = np.ones(dance[:count].shape[:2])
        take = Observation(dance[:count], weights, weights, np.arange(count) / 30.0)
        began = perf_counter()
        method.whole(take)
        seconds = perf_counter() - began
        ends = str(method.converged_)
        rows.append((count, seconds, method.iterations_, ends, _WANG_1[count]))
    flat = np.nan_to_num(dance).transpose(0, 2, 1).reshape(3 * len(dance), -1)
    values = np.linalg.svd(flat, compute_uv=False)
    values = values[values > 1e-6 * values[0]]
    spectrum = Series("dance", range(1, len(values) + 1), values / values[0])
    return Study(
        title="Time to recover a take (Wang, Table I), singular values (Figure 1)",
        columns=("frames", "seconds", "iterations", "converged", "paper_seconds"),
        rows=rows,
        panels=[
            Panel("frames", "s", series_of(rows, {"wang-low-rank": 1, "paper": 4})),
            Panel("singular value", "share of the largest", [spectrum], log_y=True),
        ],
        across=2,
    )


def shum_tables_1_2(options: Options, *, people: int = 4, takes: int = 12) -> Study:
    """Tell how far joints spread in classes of motion, and in the takes tested on.

    The standard deviation of a joint's place in a take, on the standard body, facing
    +z, relative to the root; its mean over takes and the joints of arms and of legs.
    The motions are those that the database is made of; the scenes are recorded by a
    virtual Kinect.
    """
    first, rows = first_person(options.seed), list[tuple[Cell, ...]]()
    for name, (motions, *paper) in _SHUM_1.items():
        pairs = performed_by(
            range(first, first + people), motions, progress=options.progress
        )
        postures = [standard_truth(pair, observed(pair)) for pair in pairs]
        rows.append(("I", name, *_spread(pairs, postures), *paper))
    scenes = [s for kind in CLASSES for s in study_takes(kind, options, count=takes)]
    for scene, figures in _SHUM_2.items():
        pairs = [pair for pair in scenes if pair.clip.startswith(f"{scene}_")]
        postures = [observed(pair).standard for pair in pairs]
        if pairs:
            rows.append(("II", scene, *_spread(pairs, postures), *figures))
    bars = series_of(
        [(row[1], *row[3:]) for row in rows],
        {"upper body": 1, "lower body": 2, "paper, upper": 3, "paper, lower": 4},
        kind="bars",
    )
    return Study(
        title="How far joints spread, class by class (Shum 2013, Tables I and II)",
        columns=(
            *("table", "class", "frames", "upper_cm", "lower_cm"),
            *("paper_upper_cm", "paper_lower_cm"),
        ),
        rows=rows,
        panels=[Panel("class of motion, scene", "standard deviation, cm", bars)],
    )


def _spread(
    pairs: Sequence[PairedTake], postures: Sequence[Array]
) -> tuple[int, float, float]:
    """Return frames, and standard deviations [cm] of the upper and the lower body."""
    spread, skeletons = [], [pair.take.skeleton for pair in pairs]
    for parts in (("Shoulder", "Elbow", "Wrist"), ("Knee", "Ankle", "Foot")):
        names = [part + side for part in parts for side in ("Left", "Right")]
        # Take by take: each sensor looks down by an angle of its own.
        variances = [
            np.ma.masked_invalid(posture[:, [*map(skeleton.index, names)]]).var(axis=0)
            for posture, skeleton in zip(postures, skeletons, strict=True)
        ]
        deviations = np.ma.sqrt(np.ma.stack(variances).sum(axis=2))
        spread.append(float(100.0 * deviations.mean()))
    return sum(map(len, postures)), spread[0], spread[1]


def _cm(*parts: Array) -> float:
    return float(100.0 * np.nanmean(np.concatenate(parts)))
