"""Chiang 2017, clustered Gaussian process: figures 5 and 7, tables 1, 2 and 3."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import compress, product
from time import perf_counter

import numpy as np

from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.evaluate import LEARNED_REPETITIONS, repetition
from kinefilter.pipeline.lab.systems import CorrectorFactory
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.methods import PRESETS
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over

from .study import Options, Panel, Row, Series, Study, series_of
from .study_takes import (
    Group,
    Trace,
    clips_of,
    errors,
    mean_cm,
    recorded,
    recorded_people,
    simulated,
    trace_study,
)

_CHIANG_2_3 = {
    ("deep_breathing", "all"): (9078, 10.22, 4.91, 1.46, 0.14, 1.79, 2.46),
    ("deep_breathing", "unreliable"): (3514, 13.82, 6.49, 3.10, 0.21, 3.48, 2.91),
    ("clasp_and_spread", "all"): (8043, 9.21, 8.18, 1.76, 0.13, 1.95, 3.21),
    ("clasp_and_spread", "unreliable"): (2436, 13.12, 11.89, 6.23, 0.17, 4.26, 7.58),
    ("overhead_pumping", "all"): (8638, 8.94, 7.36, 3.38, 0.21, 4.34, 5.58),
    ("overhead_pumping", "unreliable"): (3222, 13.57, 11.54, 7.45, 0.24, 7.10, 7.98),
    ("push_down_pumping", "all"): (10051, 8.38, 6.27, 2.70, 0.18, 2.72, 5.21),
    ("push_down_pumping", "unreliable"): (4400, 13.79, 10.13, 6.76, 0.35, 4.01, 7.68),
}
"""Test frames (table 1), and errors [cm] of Kinect, of Liu's method and of the paper's,
then the latter's at shoulders, elbows and wrists, by exercise and samples."""
_SYSTEMS = ("liu-2016:adapt=false", "chiang-2017")
_SAMPLES = ("all", "unreliable")
_ARM = ("Shoulder", "Elbow", "Wrist")
_EVERY = 12  # one in this many recorded clips is tested
_HELD_OUT = 0.2  # share of test frames: in the paper 5564 of 27816, and so on

_EXERCISE = ("push_down_pumping",)  # exercise 4, as in figure 5
_CENTROIDS = (25, 50, 100, 200, 400, 800, 1600)  # Q
_PAPER_CENTROIDS = 800
_PAPER_RAW, _PAPER_ERROR = 8.38, 2.70  # cm, for exercise 4 at that Q (table 2)
_FOLLOWED = (
    (("push_down_pumping", "WristLeft"), 11.38, 5.08),
    (("overhead_pumping", "ElbowLeft"), 8.56, 4.19),
)
"""Exercise and joint, and errors [cm] of Liu's method and of the paper's (table 3)."""


def chiang_tables_2_3(
    options: Options, *, people: int = 16, motions: int = 4, count: int = 1000
) -> Study:
    """Compare a clustered process with local ones, on all and on unreliable samples.

    Unreliable samples are frames in which a joint of the arms or the one between the
    shoulders scores 0.7 or less, as in the paper. Errors are those of the arms' joints
    with all bodies at standard lengths; table 3 has them by joint, table 1 the numbers
    of frames. A quarter as many people are tested as learned from. For comparison, at
    most ``count`` recorded people perform all their movements: each is left out of
    training in turn, and all are tested on new repetitions.
    """
    names = [name for name, samples in _CHIANG_2_3 if samples == "all"][:motions]
    # A v2's thumbs leave too few frames with every joint reliable.
    groups = simulated(options, names, learners=people, sensor="v1")
    found: dict[str, list[tuple[Flags, list[Array]]]] = {}
    for group in (*groups, *recorded(options, every=_EVERY, count=count)):
        tests = over(group.tests, f"correct ({group.people})", options.progress)
        for k, (pair, arms) in enumerate(_arms(group, tests)):
            name = names[k % len(names)] if group in groups else "every movement"
            key = f"{name}, {group.people}"
            found.setdefault(key, []).append((_unreliable(pair), arms))
    rows: list[Row] = []
    for (name, takes), samples in product(found.items(), _SAMPLES):
        chosen = [u if samples == "unreliable" else u | True for u, _ in takes]
        frames = int(sum(map(np.sum, chosen)))
        cm = _arm_errors(chosen, [arms for _, arms in takes]) if frames else ()
        rows.append((f"{name}, {samples}", frames, *cm))
    for name, samples in product(names, _SAMPLES):
        rows.append((f"{name}, paper, {samples}", *_CHIANG_2_3[name, samples]))
    plotted = [row for row in rows if str(row[0]).endswith("all")]
    columns = {"kinect": 2, "liu-2016": 3, "chiang-2017": 4}
    bars = series_of(plotted, columns, kind="bars")
    title = "Clustered and local processes, by exercise (Chiang 2017, Tables 1 to 3)"
    names = ["kinect", "liu", "chiang", "shoulders", "elbows", "wrists"]
    header = ("exercise, people, samples", "frames", *(f"{name}_cm" for name in names))
    panels = [Panel("exercise and people, all samples", "error, cm", bars)]
    return Study(title, header, rows, panels)


def _arms(
    group: Group, takes: Iterable[PairedTake]
) -> Iterator[tuple[PairedTake, list[Array]]]:
    """Yield takes with distances of the arms' joints [m]: raw, Liu's and Chiang's."""
    runners, distances = group.runners(_SYSTEMS), group.accuracy.standardized
    for pair in takes:
        yield pair, [distances(run(pair.take), pair.truth)[:, :6] for run in runners]


def _arm_errors(chosen: Sequence[Flags], takes: Sequence[list[Array]]) -> list[float]:
    arms = [
        np.concatenate([part[k] for k, part in zip(chosen, parts, strict=True)])
        for parts in zip(*takes, strict=True)
    ]
    by_joint = [arms[-1][:, 2 * k : 2 * k + 2] for k in range(3)]
    return [mean_cm(part) for part in (*arms, *by_joint)]


def _unreliable(pair: PairedTake) -> Flags:
    """Return the frames in which the upper body scores as unreliable, shape (T,)."""
    skeleton = pair.take.skeleton
    joints = [skeleton.girdle, *(j for part in _ARM for j in skeleton.sides(part))]
    reliability = observed(pair, CleanConfig(preset="chiang-2017")).reliability
    limit = PRESETS["chiang-2017"].settings["smallest_reliability"]
    return np.asarray((reliability[:, joints] <= limit).any(axis=1))


def chiang_table_1(options: Options, *, movements: int = 10) -> Study:
    """Split one movement's frames as the paper splits those of an exercise.

    By its frame counts, the paper trains on four in five reliable frames and tests on
    the fifth, so that neighbors are on both sides (``frames at random``). For
    comparison: new repetitions by the same people, and a person left out. As in the
    paper, each movement has its own process; every third of the first ``movements`` is
    measured. Errors are those of the arms' joints at standard lengths.
    """
    people = recorded_people(options.data)
    found: dict[str, list[list[Array]]] = {}
    clips = clips_of(people, movements, options)
    names = sorted({pair.movement for pair in clips})[::3]
    for k, name in enumerate(over(names, "movements", options.progress)):
        own = [pair for pair in clips if pair.movement == name]
        for split, (train, tests) in _splits(own, people[k % len(people)]).items():
            trainer = CorrectorFactory(train, progress=options.progress)
            group = Group(split, tests, trainer)
            found.setdefault(split, []).extend(arms for _, arms in _arms(group, tests))
    means = {
        split: [mean_cm(*parts) for parts in zip(*takes, strict=True)]
        for split, takes in found.items()
    }
    papers = [row[1:4] for (_, samples), row in _CHIANG_2_3.items() if samples == "all"]
    means["paper"] = np.mean(papers, axis=0).tolist()
    rows: list[Row] = [
        (split, raw, liu, chiang, 100.0 * (1.0 - chiang / raw))
        for split, (raw, liu, chiang) in means.items()
    ]
    bars = series_of(rows, {"kinect": 1, "liu-2016": 2, "chiang-2017": 3}, kind="bars")
    title = "Splits into training and test frames (Chiang 2017, Table 1)"
    header = ("tested on", "kinect_cm", "liu_cm", "chiang_cm", "cut_percent")
    panels = [Panel("test data", "error of the arms, cm", bars)]
    return Study(title, header, rows, panels)


def _splits(
    clips: Sequence[PairedTake], person: str
) -> dict[str, tuple[list[PairedTake], list[PairedTake]]]:
    rng, train, test = np.random.default_rng(0), list[PairedTake](), list[PairedTake]()
    for pair in clips:
        held_out = (rng.random(len(pair.take)) < _HELD_OUT)[:, None, None]
        train.append(replace(pair, truth=np.where(held_out, np.nan, pair.truth)))
        test.append(replace(pair, truth=np.where(held_out, pair.truth, np.nan)))
    late = [repetition(pair) > LEARNED_REPETITIONS for pair in clips]
    early = np.logical_not(late)
    own = [pair.subject == person for pair in clips]
    others = np.logical_not(own)
    return {
        "frames at random": (train, test[::3]),
        "new repetitions": ([*compress(clips, early)], [*compress(clips, late)][::3]),
        "a new person": ([*compress(clips, others)], [*compress(clips, own)][::3]),
    }


def chiang_figure_5(options: Options, *, people: int = 40, values: int = 7) -> Study:
    """Vary the number of centroids of the process, for one exercise.

    The paper tests on the people in its training data and assumes standard lengths;
    here all people have their own. It plots its errors over Q without values; its table
    2 has those at Q = 800. An eighth as many people are tested as learned from;
    ``values`` of Q are tried, from the smallest.
    """
    groups = simulated(options, _EXERCISE, learners=people, share=8, sensor="v1")
    frames = sum(len(pair.take) for group in groups for pair in group.tests)
    raw = errors(groups, None)
    rows: list[Row] = [("raw", *raw.values(), None, _PAPER_RAW)]
    for count in over(_CENTROIDS[:values], "centroids", options.progress):
        preset = f"chiang-2017:centroids={count}"
        for group in groups:
            group.runners([preset])  # trained before the timing starts
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
    title = "Centroids of the clustered process (Chiang 2017, Figure 5)"
    header = ("centroids_Q", "new_people_cm", "known_people_cm", "ms", "paper_cm")
    panels = [
        Panel(label, "error, cm", lines, log_x=True),
        Panel(label, "ms per frame", times, log_x=True),
    ]
    return Study(title, header, rows, panels, across=2)


def chiang_figure_7(options: Options, *, people: int = 16) -> Study:
    """Follow the left wrist through one exercise, and the left elbow through another.

    The paper's errors are those of all samples in its table 3, which has none for
    Kinect. A quarter as many people are tested as learned from.
    """
    liu, chiang = _SYSTEMS
    paths = [
        Trace(*followed, {"kinect": None, liu: liu_cm, chiang: chiang_cm})
        for followed, liu_cm, chiang_cm in _FOLLOWED
    ]
    title = "A wrist and an elbow during exercises (Chiang 2017, Figure 7)"
    return trace_study(options, title, paths, people=people, sensor="v1", standard=True)
