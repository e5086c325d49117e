"""Liu 2016, local Gaussian processes: tables 2, 3, 4 and 5, figures 3, 7 and 8."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import compress
from pathlib import Path
from time import perf_counter
from typing import cast

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.recorded_acts import Pair, paired_by, pairs_of
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.lab.systems import systems_of
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over
from kinefilter.pipeline.workers import workers

from .doubtful_limbs import errors_in_doubt
from .study import Cell, Options, Panel, Series, Study, series_of
from .takes import first_person, recorded_people
from .traces import Trace, trace_study
from .trial import Group, errors, mean_cm, school_of, simulated

_NEW, _KNOWN = "new people", "known people"
_OFFLINE = "liu-2016:adapt=false"

_HARD = ("tai_chi", "bend", "cross_arms")  # the motions of table 5
_SAMPLES = (5, 10, 20, 50)  # S
_BLENDED = (1, 3, 9, 15)  # L
_CHOSEN = (50, 9)  # S and L

_WALKING = ("march",)  # on the spot: who walks leaves the sensor's view
_WALKING_SAMPLES, _WALKING_KEPT = 1120, 681
_REDUNDANCIES = (0.0, 0.02, 0.1, 0.5)
_WIDE = "clusters=16:samples=200:blended=3"  # so many samples that no model is full

_LIU_2 = {
    "tai_chi": (411, 650, 2320),
    "bend": (201, 320, 1580),
    "golf_swing": (296, 460, 1765),
    "cross_arms": (245, 380, 1685),
    "wave": (221, 350, 1650),
    "clap": (270, 420, 1720),
    "roll_hands": (306, 475, 2050),
    "bend_leg": (243, 385, 1890),
}
"""Frames of Liu, of Zhou and of Shen, without one of the two ways of rolling hands."""

_LIU_3 = {
    "cross_arms": (12.5, 9.8, 7.2, 7.9, 7.4),
    "bend": (13.7, 9.5, 8.4, 9.2, 8.7),
    "tai_chi": (14.5, 10.2, 7.5, 8.0, 7.4),
    "wave": (12.5, 8.8, 6.5, 6.9, 6.6),
}
"""Errors [cm] of Kinect and of the presets in their order."""
_SYSTEMS = ("shen-2012", "zhou-2014", _OFFLINE, "liu-2016")
_MS = (None, None, 37.0, None, 29.0)  # a frame: full, and local processes

_LIU_4 = {
    "cross_arms": (13.8, 8.1),
    "golf_swing": (14.9, 9.4),
    "wave": (13.5, 7.3),
    "roll_hands": (13.7, 7.4),
    "clap": (14.3, 8.5),
    "stand_idle": (7.8, 7.1),
}
"""Errors [cm] of randomized forests and of the paper's method; it has a T-pose where
the library has people who stand."""
_FOLDS = 5
_MOVES = 190  # clips of a recorded person, about

_TERMS: dict[str, tuple[str, float]] = {
    "S": (":temporal=0:reliability=0", 12.0),
    "S+T": (":reliability=0", 10.5),
    "S+R": (":temporal=0", 9.7),
    "S+T+R": ("", 7.9),
}
"""What leaves out terms, and the paper's errors [cm]."""


_ALONE = f"{_OFFLINE}{_TERMS['S'][0]}"


def liu_figure_3(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Drop the samples of walking that their neighbors predict (posture budgeting).

    From 1120 samples, as in the paper, where 681 of them do about as well. They are
    dropped joint by joint: the count is the mean over joints. Error is that of the
    predicted offsets alone. Half as many people are tested as walk for the method to
    learn; ``values`` of the thresholds are tried, from the one that drops nothing.
    """
    groups = simulated(options, _WALKING, learners=people, share=2)
    rows: list[tuple[Cell, ...]] = []
    for redundancy in over(_REDUNDANCIES[:values], "budget", options.progress):
        kept, found = _budgeted(groups, _WALKING_SAMPLES, redundancy)
        paper = None if rows else _WALKING_SAMPLES
        rows.append((redundancy, kept, *found, paper))
    label = "samples kept (paper: 681 of 1120 at about the same error)"
    lines = series_of(rows, {_NEW: 2, _KNOWN: 3}, x=1)
    return Study(
        title="Posture budgeting: samples kept against error (Liu 2016, Figure 3)",
        columns=(
            *("redundancy", "samples_kept", "new_people_cm", "known_people_cm"),
            "paper_samples_kept",
        ),
        rows=[*rows, ("paper", None, None, None, _WALKING_KEPT)],
        panels=[Panel(label, "error, cm", lines)],
    )


def _budgeted(
    groups: list[Group], frames: int, redundancy: float
) -> tuple[float, list[float]]:
    """Return how many samples of some frames are kept, and errors [cm] with them."""
    sizes = f"{_WIDE}:frames={frames}:redundancy={redundancy}"
    preset = f"{_ALONE}:{sizes}"
    (system,) = systems_of((), [preset])
    method = cast(LocalGP, groups[0].school.corrector(system))
    kept = float(method.counts_.sum() / len(method.joints_))
    return kept, [*errors(groups, preset).values()]


def liu_table_2(options: Options, *, people: int = 10, motions: int = 8) -> Study:
    """Count the frames that posture budgeting leaves of each motion's database.

    It is given as many as the paper has for Shen's exemplars, and drops those that the
    preset's redundancy says; errors are those of predicted offsets alone. Every motion
    has a database of its own, though the paper's local models need none: frames are
    then counted as in its table. A tenth as many people are tested as perform for the
    method to learn.
    """
    rows: list[tuple[Cell, ...]] = []
    names = [*_LIU_2][:motions]
    for name in over(names, "budget", options.progress):
        ours, zhou, shen = _LIU_2[name]
        groups = simulated(options, [name], learners=people, share=10, sensor="v1")
        kept, found = _budgeted(groups, shen, 0.01)
        rows.append((name, shen, kept, *found, ours, zhou))
    sums = [sum(cast(float, row[k]) for row in rows) for k in (1, 2, -2, -1)]
    bars = series_of(rows, {"kept": 2, "paper, Liu": 5, "paper, Zhou": 6}, kind="bars")
    rows.append(("all", *sums[:2], None, None, *sums[2:]))
    return Study(
        title="Frames in the database of each motion (Liu 2016, Table 2)",
        columns=(
            *("motion", "frames", "kept", "new_people_cm", "known_people_cm"),
            *("paper_liu", "paper_zhou"),
        ),
        rows=rows,
        panels=[Panel("motion", "frames", bars)],
    )


def liu_table_3(options: Options, *, people: int = 8, motions: int = 4) -> Study:
    """Compare local processes with exemplars and with full ones, motion by motion.

    The paper says nothing of who was tested, and times whole systems: with locality and
    without. An eighth as many people are tested as perform for the methods to learn.
    The study ``presets`` has the same systems on recorded people and hidden limbs.
    """
    names = [*_LIU_3][:motions]
    found: dict[str, list[list[Array]]] = {}
    seconds, frames = np.zeros(len(_SYSTEMS) + 1), 0
    for group in simulated(options, names, learners=people, share=8):
        makers = group.makers(_SYSTEMS)
        label = f"correct ({group.people})"
        for k, pair in enumerate(over(group.tests, label, options.progress)):
            parts = []
            for n, make in enumerate(makers):
                began = perf_counter()
                positions = make(pair.take)
                seconds[n] += perf_counter() - began
                parts.append(group.accuracy.distances(positions, pair.truth))
            name = f"{names[k % len(names)]}, {group.people}"
            found.setdefault(name, []).append(parts)
            frames += len(pair.take)
    rows: list[tuple[Cell, ...]] = [
        (name, *(mean_cm(*parts) for parts in zip(*takes, strict=True)))
        for name, takes in found.items()
    ]
    rows += [(f"{name}, paper", *_LIU_3[name]) for name in names]
    labels = ("kinect", "shen", "zhou", "liu, offline", "liu, incremental")
    columns = {label: k for k, label in enumerate(labels, 1)}
    bars = series_of(rows, columns, kind="bars")
    milliseconds = 1e3 * seconds[1:] / frames
    rows.append(("ms a frame", None, *milliseconds))
    rows.append(("ms a frame, paper", *_MS))
    offline = milliseconds[_SYSTEMS.index(_OFFLINE)]
    rows.append(("times as long as offline", None, *(milliseconds / offline)))
    who = ("kinect", "shen_2012", "zhou_2014", "liu_offline", "liu_incremental")
    return Study(
        title="Exemplars, full and local processes (Liu 2016, Table 3 and section 5.3)",
        columns=("motion, people", *(f"{name}_cm" for name in who)),
        rows=rows,
        panels=[Panel("motion and people", "error, cm", bars)],
    )


def liu_table_4(
    options: Options, *, people: int = 5, motions: int = 6, clips: int = 6
) -> Study:
    """Correct what a tracker of depth images finds, people in five folds.

    A forest tells body parts and mean shift finds joints in them (``forest``), as in
    the paper; it has met none of these people, but other bodies that perform the same
    scripts. The preset learns from the same images of the other four fifths of the
    people. Below are ``clips`` movements of each recorded person, marker mocap before
    the same tracker, each person left out in turn.
    """
    names, first = [*_LIU_4][:motions], first_person(options.seed, learners=True)
    acts = [(name, first + k) for k in range(people) for name in names]
    who = recorded_people(options.data) if options.data else []
    moves: list[Pair] = []
    for name in who:
        every = max(_MOVES // clips, 1)
        moves += [*pairs_of(Path(f"{options.data}/ui-prmd/{name}.npz"), every)][:clips]
    look = partial(simulate, "basic", tracker="depth")
    with workers() as pool:
        jobs = [pool.submit(look, name, seed=seed) for name, seed in acts]
        jobs += [pool.submit(paired_by, move, "depth") for move in moves]
        takes = [job.result() for job in over(jobs, "look", options.progress)]
    labels = [name for name, _ in acts] + ["every movement"] * len(moves)
    found: dict[str, list[list[Array]]] = {}
    for some in (slice(len(acts)), slice(len(acts), None)):
        for group, rows_of in _folds(takes[some], labels[some], options):
            makers = group.makers([_OFFLINE])
            for pair, label in zip(group.tests, rows_of, strict=True):
                parts = [
                    group.accuracy.distances(make(pair.take), pair.truth)
                    for make in makers
                ]
                found.setdefault(label, []).append(parts)
    rows: list[tuple[Cell, ...]] = [
        (name, *(mean_cm(*p) for p in zip(*parts, strict=True)), *_LIU_4.get(name, ()))
        for name, parts in found.items()
    ]
    rows = [(*row, None, None)[:5] for row in rows]
    columns = {"forest": 1, "liu, offline": 2, "paper, forest": 3, "paper, Liu": 4}
    bars = series_of(rows, columns, kind="bars")
    return Study(
        title="A tracker of depth images, corrected (Liu 2016, Table 4)",
        columns=("motion", "forest_cm", "liu_cm", "paper_forest_cm", "paper_liu_cm"),
        rows=rows,
        panels=[Panel("motion", "error, cm", bars)],
    )


def _folds(
    takes: Sequence[PairedTake], labels: Sequence[str], options: Options
) -> Iterator[tuple[Group, list[str]]]:
    """Yield a fifth of the people, taught by the others, and what their takes show."""
    people = list(dict.fromkeys(take.subject for take in takes))
    for k in range(min(_FOLDS, len(people))):
        out = np.isin([take.subject for take in takes], people[k::_FOLDS])
        group = Group(
            "new", [*compress(takes, out)], school_of([*compress(takes, ~out)], options)
        )
        yield group, [*compress(labels, out)]


def liu_figure_7(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Vary the samples of a local model, S, and the local models blended, L.

    The paper's figure is printed without its values; it chooses S = 50 and L = 9,
    beyond which its error hardly falls. Error is that of the preset, but that it does
    not learn from the takes. A quarter as many people are tested as perform for the
    method to learn; ``values`` of S and of L are tried, from the smallest.
    """
    groups = simulated(options, _HARD, learners=people)
    rows: list[tuple[Cell, ...]] = []
    for samples in _SAMPLES[:values]:
        for blended in over(_BLENDED[:values], f"S = {samples}", options.progress):
            preset = f"{_OFFLINE}:samples={samples}:blended={blended}"
            paper = "chosen" if (samples, blended) == _CHOSEN else None
            rows.append((samples, blended, *errors(groups, preset).values(), paper))
    panels = []
    for group, column in ((_NEW, 2), (_KNOWN, 3)):
        lines: list[Series] = []
        for samples in _SAMPLES[:values]:
            own = [row for row in rows if row[0] == samples]
            lines += series_of(own, {f"S = {samples}": column}, x=1)
        label = f"L, {group} (the paper chooses S = 50, L = 9)"
        panels.append(Panel(label, "error, cm", lines, zero=False))
    return Study(
        title="Samples a local model, and models blended (Liu 2016, Figure 7)",
        columns=(
            *("samples_S", "blended_L", "new_people_cm", "known_people_cm"),
            "paper",
        ),
        rows=rows,
        panels=panels,
        across=2,
    )


def liu_figure_8(options: Options, *, people: int = 16) -> Study:
    """Follow the left wrist of people who swing a golf club.

    The paper follows the hand, which the sensor's trackers put anywhere. The last row
    is that of predicted offsets alone. A quarter as many people are tested as perform
    for the method to learn.
    """
    paper = {"kinect": 12.36, _OFFLINE: 8.1, "liu-2016": 7.7, _ALONE: None}
    trace = Trace("golf_swing", "WristLeft", paper)
    title = "The left wrist in a golf swing (Liu 2016, Figure 8)"
    return trace_study(options, title, [trace], people=people, sensor="v2")


def liu_table_5(
    options: Options, *, people: int = 8, count: int = 1000, clips: int = 1000
) -> Study:
    """Leave out terms of the energy where the sensor is in doubt of a limb.

    On simulated tai chi, bending over and crossing arms, as in the paper; half as many
    people are tested as perform for the method to learn. On at most ``count`` recorded
    people, of whom every twentieth clip, at most ``clips``, is tested with a limb
    hidden. The preset is the paper's, but that it does not learn from the takes.
    """
    groups = simulated(options, _HARD, learners=people, share=2)
    presets = {f"{_OFFLINE}{left_out}": name for name, (left_out, _) in _TERMS.items()}
    found = {"raw": errors(groups, None)}
    for preset, name in over([*presets.items()], "terms", options.progress):
        found[name] = errors(groups, preset)
    situations = {"the paper": {name: paper for name, (_, paper) in _TERMS.items()}}
    for who in ("new", "known"):
        situations[f"simulated {who} people"] = {n: e[who] for n, e in found.items()}
    if options.data is not None:
        for label, error in errors_in_doubt(
            options, presets=[*presets], count=count, most=clips
        ).items():
            for where, value in error.items():
                row = situations.setdefault(f"recorded, {where}", {})
                row[presets.get(label, label)] = value
    names = ("raw", "none", *_TERMS)
    rows = [
        (where, *map(row.get, names), 100.0 - 100.0 * row["S+T+R"] / row["S"])
        for where, row in situations.items()
    ]
    drawn = [row for row in rows if str(row[0]).count(",") < 2]
    columns = {name: names.index(name) + 1 for name in _TERMS}
    bars = series_of(drawn, columns, kind="bars")
    return Study(
        title="Terms of the energy of liu-2016 (Liu 2016, Table 5)",
        columns=("situation", *(f"{n}_cm" for n in names), "less_than_S_percent"),
        rows=rows,
        panels=[Panel("terms of the energy", "error, cm", bars)],
    )
