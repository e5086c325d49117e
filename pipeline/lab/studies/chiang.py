"""Chiang 2017, a clustered Gaussian process: figures 5 and 7, tables 1, 2 and 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from time import perf_counter

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.evaluate import LEARNED_REPETITIONS, repetition
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.presets import PRESETS
from kinefilter.pipeline.progress import over

from .study import Cell, Options, Panel, Series, Study, series_of
from .takes import clips_of, recorded_people
from .traces import Trace, trace_study
from .trial import Group, errors, mean_cm, recorded, school_of, simulated

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
_FRAMES = {
    "deep_breathing": (5564, 3514),
    "clasp_and_spread": (5607, 2436),
    "overhead_pumping": (5416, 3222),
    "push_down_pumping": (5651, 4400),
}
"""Frames tested, reliable and unreliable ones (table 1)."""
_SYSTEMS = ("liu-2016:adapt=false", "chiang-2017")
_SAMPLES = ("all", "unreliable")
_ARM = ("Shoulder", "Elbow", "Wrist")
_EVERY = 12  # one in this many recorded clips is tested
_HELD_OUT = 0.2  # of the frames: the paper tests on 5564 of 27816, and so on

_EXERCISE = ("push_down_pumping",)  # exercise 4, that of figure 5
_CENTROIDS = (25, 50, 100, 200, 400, 800, 1600)  # Q
_PAPER_CENTROIDS = 800
_PAPER_RAW, _PAPER_ERROR = 8.38, 2.70  # cm, of exercise 4 at that Q (table 2)

_FOLLOWED = (
    (("push_down_pumping", "WristLeft"), 11.38, 5.08),
    (("overhead_pumping", "ElbowLeft"), 8.56, 4.19),
)
"""Exercise and joint, and errors [cm] of Liu's method and of the paper's (table 3)."""


def chiang_tables_2_3(
    options: Options, *, people: int = 16, motions: int = 4, count: int = 1000
) -> Study:
    """Compare a clustered process with local ones, on all samples and unreliable ones.

    Those are frames in which a joint of the arms, or between the shoulders, scores 0.7
    or less, as the paper has it; errors are those of the arms' joints, all bodies at
    standard lengths. Table 3 has them joint by joint, table 1 the frames. A quarter as
    many people are tested as the methods learn from. Beside them stand at most
    ``count`` recorded people in all their movements, each left out in turn, and new
    repetitions of those who taught.
    """
    names = [*_CHIANG_2_3][:motions]
    # A v2's thumbs leave too few frames with every joint reliable.
    groups = simulated(options, names, learners=people, sensor="v1")
    found: dict[str, list[tuple[Flags, list[Array]]]] = {}
    for group in (*groups, *recorded(options, every=_EVERY, count=count)):
        makers, away = group.makers(_SYSTEMS), group.accuracy.standardized
        label = f"correct ({group.people})"
        for k, pair in enumerate(over(group.tests, label, options.progress)):
            arms = [away(make(pair.take), pair.truth)[:, :6] for make in makers]
            name = names[k % len(names)] if group in groups else "every movement"
            doubtful = _unreliable(pair, group.skeleton)
            found.setdefault(f"{name}, {group.people}", []).append((doubtful, arms))
    rows: list[tuple[Cell, ...]] = []
    for name, takes in found.items():
        for samples in _SAMPLES:
            some = [d if samples == "unreliable" else d | True for d, _ in takes]
            frames = int(sum(map(np.sum, some)))
            errors = _arm_errors(some, [arms for _, arms in takes]) if frames else ()
            rows.append((f"{name}, {samples}", frames, *errors))
    for name in names:
        reliable, unreliable = _FRAMES[name]
        counts = reliable + unreliable, unreliable
        for samples, frames, paper in zip(
            _SAMPLES, counts, _CHIANG_2_3[name], strict=True
        ):
            rows.append((f"{name}, paper, {samples}", frames, *paper))
    bars = series_of(
        [row for row in rows if str(row[0]).endswith("all")],
        {"kinect": 2, "liu-2016": 3, "chiang-2017": 4},
        kind="bars",
    )
    columns = ("kinect", "liu", "chiang", "shoulders", "elbows", "wrists")
    return Study(
        title="Clustered and local processes on four exercises (Chiang 2017, 1 to 3)",
        columns=(
            *("exercise, people, samples", "frames"),
            *(f"{name}_cm" for name in columns),
        ),
        rows=rows,
        panels=[Panel("exercise and people, all samples", "error, cm", bars)],
    )


def _arm_errors(some: Sequence[Flags], takes: Sequence[list[Array]]) -> list[float]:
    """Return errors [cm] in some frames: of each motion, and of the last by joint."""
    arms = [
        np.concatenate([part[k] for k, part in zip(some, parts, strict=True)])
        for parts in zip(*takes, strict=True)
    ]
    by_joint = [arms[-1][:, 2 * k : 2 * k + 2] for k in range(3)]
    return [mean_cm(part) for part in (*arms, *by_joint)]


def _unreliable(pair: PairedTake, skeleton: Skeleton) -> Flags:
    """Return the frames in which Chiang's reliability doubts the upper body, (T,)."""
    preset = PRESETS["chiang-2017"]
    draft = observed(pair, CleanConfig(preset="chiang-2017"))
    names = [part + side for part in _ARM for side in ("Left", "Right")]
    joints = [skeleton.girdle, *map(skeleton.index, names)]
    least = preset.settings["smallest_reliability"]
    return np.asarray((draft.reliability[:, joints] <= least).any(axis=1))


def chiang_table_1(options: Options, *, movements: int = 10) -> Study:
    """Split one movement's frames as the paper splits those of an exercise.

    Its table 1 has four in five reliable frames to learn from and the fifth to test on,
    to the frame: frames next to each other are on both sides (``frames at random``).
    Beside that stand new repetitions by the same people, and a person left out, another
    one in each movement. Each movement has a process of its own, as in the paper; every
    third of the first ``movements`` is measured. Errors are those of the arms' joints
    at standard lengths.
    """
    people = recorded_people(options.data)
    found: dict[str, list[list[Array]]] = {}
    clips = clips_of(people, movements, options)
    names = sorted({pair.movement for pair in clips})[::3]
    for k, name in enumerate(over(names, "movements", options.progress)):
        some = [pair for pair in clips if pair.movement == name]
        for who, (lessons, tests) in _splits(some, people[k % len(people)]).items():
            group = Group(who, tests, school_of(lessons, options))
            makers, away = group.makers(_SYSTEMS), group.accuracy.standardized
            for pair in tests:
                arms = [away(make(pair.take), pair.truth)[:, :6] for make in makers]
                found.setdefault(who, []).append(arms)
    rows: list[tuple[Cell, ...]] = []
    for who, takes in found.items():
        raw, liu, chiang = (mean_cm(*parts) for parts in zip(*takes, strict=True))
        rows.append((who, raw, liu, chiang, 100.0 * (1.0 - chiang / raw)))
    papers = [figures[0][:3] for figures in _CHIANG_2_3.values()]
    raw, liu, chiang = np.mean(papers, axis=0).tolist()
    rows.append(("paper", raw, liu, chiang, 100.0 * (1.0 - chiang / raw)))
    columns = {"kinect": 1, "liu-2016": 2, "chiang-2017": 3}
    bars = series_of(rows, columns, kind="bars")
    return Study(
        title="How frames are split to learn and to test (Chiang 2017, Table 1)",
        columns=("tested on", "kinect_cm", "liu_cm", "chiang_cm", "cut_percent"),
        rows=rows,
        panels=[Panel("tested on", "error of the arms, cm", bars)],
    )


def _splits(
    clips: Sequence[PairedTake], person: str
) -> dict[str, tuple[list[PairedTake], list[PairedTake]]]:
    """Return clips to learn from and every third of those to test on, by protocol."""
    rng, seen, held = np.random.default_rng(0), list[PairedTake](), list[PairedTake]()
    for pair in clips:
        out = (rng.random(len(pair.take)) < _HELD_OUT)[:, None, None]
        seen.append(replace(pair, truth=np.where(out, np.nan, pair.truth)))
        held.append(replace(pair, truth=np.where(out, pair.truth, np.nan)))
    late = [repetition(pair) > LEARNED_REPETITIONS for pair in clips]
    early = [not one for one in late]
    own = [pair.subject == person for pair in clips]
    others = [not one for one in own]
    return {
        "frames at random": (seen, held[::3]),
        "new repetitions": ([*compress(clips, early)], [*compress(clips, late)][::3]),
        "a new person": ([*compress(clips, others)], [*compress(clips, own)][::3]),
    }


def chiang_figure_5(options: Options, *, people: int = 40, values: int = 7) -> Study:
    """Vary the number of centroids that the process is on, for one exercise.

    The paper tests on the people whom it learned from, and assumes standard lengths;
    here all have their own. Its errors over Q are a plot without values; its table 2
    has those of Q = 800. An eighth as many people are tested as perform for the method
    to learn; ``values`` of Q are tried, from the smallest.
    """
    groups = simulated(options, _EXERCISE, learners=people, share=8, sensor="v1")
    frames = sum(len(pair.take) for group in groups for pair in group.tests)
    raw = errors(groups, None)
    rows: list[tuple[Cell, ...]] = [("raw", *raw.values(), None, _PAPER_RAW)]
    for count in over(_CENTROIDS[:values], "centroids", options.progress):
        preset = f"chiang-2017:centroids={count}"
        for group in groups:
            group.makers([preset])  # is taught before the time is taken
        start = perf_counter()
        found = errors(groups, preset)
        milliseconds = 1e3 * (perf_counter() - start) / frames
        paper = _PAPER_ERROR if count == _PAPER_CENTROIDS else None
        rows.append((count, *found.values(), milliseconds, paper))
    lines = [
        *series_of(rows[1:], {"new people": 1, "known people": 2}),
        *(Series(f"{who} people, raw", (), [cm], "level") for who, cm in raw.items()),
        Series("paper, Q = 800", (), [_PAPER_ERROR], "level"),
    ]
    times = series_of(rows[1:], {"chiang-2017": 3})
    label = "centroids Q (the paper chooses 800)"
    return Study(
        title="Centroids of the clustered process (Chiang 2017, Figure 5)",
        columns=("centroids_Q", "new_people_cm", "known_people_cm", "ms", "paper_cm"),
        rows=rows,
        panels=[
            Panel(label, "error, cm", lines, log_x=True),
            Panel(label, "ms a frame", times, log_x=True),
        ],
        across=2,
    )


def chiang_figure_7(options: Options, *, people: int = 16) -> Study:
    """Follow the left wrist and the left elbow through an exercise each.

    Errors are those of all samples in the paper's table 3; of Kinect it has none joint
    by joint. A quarter as many people are tested as perform for the presets to learn.
    """
    liu, chiang = _SYSTEMS
    traces = [
        Trace(*followed, {"kinect": None, liu: theirs, chiang: own})
        for followed, theirs, own in _FOLLOWED
    ]
    title = "A wrist and an elbow through exercises (Chiang 2017, Figure 7)"
    return trace_study(
        options, title, traces, people=people, sensor="v1", standard=True
    )
