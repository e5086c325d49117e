"""Liu 2016, local Gaussian processes: tables 2, 3, 4 and 5, figures 3, 7 and 8."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import compress
from pathlib import Path
from time import perf_counter
from typing import cast

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.recorded_acts import Pair, pairs_of, simulated_pair_of
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.systems import CorrectorFactory, systems_of
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import over
from kinefilter.pipeline.workers import workers

from .method_comparison import hidden_limb_errors
from .study import Options, Panel, Row, Series, Study, series_of
from .study_takes import (
    Group,
    Trace,
    errors,
    first_person,
    mean_cm,
    recorded_people,
    simulated,
    trace_study,
)

_NEW, _KNOWN = "new people", "known people"
_HEADER = ("new_people_cm", "known_people_cm")
_OFFLINE = "liu-2016:adapt=false"

_HARD = ("tai_chi", "bend", "cross_arms")  # motions of table 5
_SAMPLES = (5, 10, 20, 50)  # S
_BLENDED = (1, 3, 9, 15)  # L
_CHOSEN = (50, 9)  # S and L in the paper

_WALKING = ("march",)  # on the spot, because walking leaves the sensor's view
_WALKING_SAMPLES, _WALKING_KEPT = 1120, 681
_REDUNDANCIES = (0.0, 0.02, 0.1, 0.5)
_WIDE = "clusters=16:samples=200:blended=3"  # with room for all samples

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
"""Frames of Liu, of Zhou and of Shen. The paper rolls hands in two ways, here one."""
_LIU_3 = {
    "cross_arms": (12.5, 9.8, 7.2, 7.9, 7.4),
    "bend": (13.7, 9.5, 8.4, 9.2, 8.7),
    "tai_chi": (14.5, 10.2, 7.5, 8.0, 7.4),
    "wave": (12.5, 8.8, 6.5, 6.9, 6.6),
}
"""Errors [cm] of Kinect, then of ``_SYSTEMS``."""
_SYSTEMS = ("shen-2012", "zhou-2014", _OFFLINE, "liu-2016")
_MS = (None, None, 37.0, None, 29.0)  # per frame: full and local processes

_LIU_4 = {
    "cross_arms": (13.8, 8.1),
    "golf_swing": (14.9, 9.4),
    "wave": (13.5, 7.3),
    "roll_hands": (13.7, 7.4),
    "clap": (14.3, 8.5),
    "stand_idle": (7.8, 7.1),
}
"""Errors [cm] of randomized forests and of the paper's method. The paper has a T-pose
in place of ``stand_idle``."""
_FOLDS = 5
_CLIPS = 190  # per recorded person, approximately

_TERMS: dict[str, tuple[str, float]] = {
    "S": (":temporal=0:reliability=0", 12.0),
    "S+T": (":reliability=0", 10.5),
    "S+R": (":temporal=0", 9.7),
    "S+T+R": ("", 7.9),
}
"""Settings with only these terms, and the paper's errors [cm]."""
_OFFSETS_ALONE = f"{_OFFLINE}{_TERMS['S'][0]}"


def liu_figure_3(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Drop samples of walking that their neighbors predict (posture budgeting).

    There are 1120 samples, as in the paper, where 681 of them do about as well. They
    are dropped joint by joint: the count is the mean over joints. Errors are those of
    the predicted offsets alone. Half as many people are tested as learned from;
    ``values`` of the thresholds are tried, from the one that drops nothing.
    """
    groups = simulated(options, _WALKING, learners=people, share=2)
    rows: list[Row] = []
    for redundancy in over(_REDUNDANCIES[:values], "budget", options.progress):
        kept, cm = _budgeted(groups, _WALKING_SAMPLES, redundancy)
        paper = None if rows else _WALKING_SAMPLES
        rows.append((redundancy, kept, *cm, paper))
    label = "samples kept (paper: 681 of 1120 at about the same error)"
    panels = [Panel(label, "error, cm", series_of(rows, {_NEW: 2, _KNOWN: 3}, x=1))]
    rows.append(("paper", None, None, None, _WALKING_KEPT))
    title = "Posture budgeting: error by samples kept (Liu 2016, Figure 3)"
    header = ("redundancy", "samples_kept", *_HEADER, "paper_samples_kept")
    return Study(title, header, rows, panels)


def _budgeted(
    groups: list[Group], frames: int, redundancy: float
) -> tuple[float, list[float]]:
    """Return the number of samples kept out of ``frames``, and the errors [cm]."""
    preset = f"{_OFFSETS_ALONE}:{_WIDE}:frames={frames}:redundancy={redundancy}"
    (system,) = systems_of((), [preset])
    method = cast(LocalGP, groups[0].trainer.corrector(system))
    kept = float(method.counts_.sum() / len(method.joints_))
    return kept, [*errors(groups, preset).values()]


def liu_table_2(options: Options, *, people: int = 10, motions: int = 8) -> Study:
    """Count the frames that posture budgeting keeps in each motion's database.

    It starts from as many frames as the paper's table has for Shen's exemplars, and
    drops those that the preset's redundancy allows. Each motion has its own database,
    though the paper's local models need none. Errors are those of the predicted offsets
    alone. A tenth as many people are tested as learned from.
    """
    rows: list[Row] = []
    names = [*_LIU_2][:motions]
    for name in over(names, "budget", options.progress):
        liu, zhou, shen = _LIU_2[name]
        groups = simulated(options, [name], learners=people, share=10, sensor="v1")
        kept, cm = _budgeted(groups, shen, 0.01)
        rows.append((name, shen, kept, *cm, liu, zhou))
    sums = [sum(cast(float, row[k]) for row in rows) for k in (1, 2, -2, -1)]
    bars = series_of(rows, {"kept": 2, "paper, Liu": 5, "paper, Zhou": 6}, kind="bars")
    rows.append(("all", *sums[:2], None, None, *sums[2:]))
    title = "Frames in the database of each motion (Liu 2016, Table 2)"
    header = ("motion", "frames", "kept", *_HEADER, "paper_liu", "paper_zhou")
    return Study(title, header, rows, [Panel("motion", "frames", bars)])


def liu_table_3(options: Options, *, people: int = 8, motions: int = 4) -> Study:
    """Compare local processes with exemplars and full processes, motion by motion.

    The paper does not say who was tested, and times whole systems, with locality and
    without. An eighth as many people are tested as learned from.
    """
    names = [*_LIU_3][:motions]
    found: dict[str, list[list[Array]]] = {}
    seconds, frames = np.zeros(len(_SYSTEMS) + 1), 0
    for group in simulated(options, names, learners=people, share=8):
        runners = group.runners(_SYSTEMS)
        label = f"correct ({group.people})"
        for k, pair in enumerate(over(group.tests, label, options.progress)):
            parts = []
            for n, run in enumerate(runners):
                start = perf_counter()
                positions = run(pair.take)
                seconds[n] += perf_counter() - start
                parts.append(group.accuracy.distances(positions, pair.truth))
            name = f"{names[k % len(names)]}, {group.people}"
            found.setdefault(name, []).append(parts)
            frames += len(pair.take)
    rows: list[Row] = [
        (name, *(mean_cm(*parts) for parts in zip(*takes, strict=True)))
        for name, takes in found.items()
    ]
    rows += [(f"{name}, paper", *_LIU_3[name]) for name in names]
    labels = ("kinect", "shen", "zhou", "liu, offline", "liu, incremental")
    bars = series_of(rows, {label: k for k, label in enumerate(labels, 1)}, kind="bars")
    milliseconds = 1e3 * seconds[1:] / frames
    rows.append(("ms a frame", None, *milliseconds))
    rows.append(("ms a frame, paper", *_MS))
    offline = milliseconds[_SYSTEMS.index(_OFFLINE)]
    rows.append(("times as long as offline", None, *(milliseconds / offline)))
    systems = ("kinect", "shen_2012", "zhou_2014", "liu_offline", "liu_incremental")
    title = "Exemplars, full and local processes (Liu 2016, Table 3 and section 5.3)"
    header = ("motion, people", *(f"{name}_cm" for name in systems))
    return Study(title, header, rows, [Panel("motion and people", "error, cm", bars)])


def liu_table_4(
    options: Options, *, people: int = 5, motions: int = 6, clips: int = 6
) -> Study:
    """Correct the output of a tracker of depth images, with people in five folds.

    As in the paper, a forest classifies body parts and mean shift locates joints in
    them (``forest``); it learned from other bodies that perform the same scripts. The
    preset is trained on the same images of the people in the other four folds. The last
    row has ``clips`` movements of each recorded person, with the marker mocap seen by
    the same tracker and each person left out in turn.
    """
    names, first = [*_LIU_4][:motions], first_person(options.seed, learners=True)
    acts = [(name, first + k) for k in range(people) for name in names]
    moves: list[Pair] = []
    for name in recorded_people(options.data) if options.data else []:
        every = max(_CLIPS // clips, 1)
        moves += [*pairs_of(Path(f"{options.data}/ui-prmd/{name}.npz"), every)][:clips]
    record = partial(simulate, "basic", tracker="depth")
    with workers() as pool:
        jobs = [pool.submit(record, name, seed=seed) for name, seed in acts]
        jobs += [pool.submit(simulated_pair_of, move, "depth") for move in moves]
        takes = [job.result() for job in over(jobs, "record", options.progress)]
    labels = [name for name, _ in acts] + ["every movement"] * len(moves)
    found: dict[str, list[list[Array]]] = {}
    for part in (slice(len(acts)), slice(len(acts), None)):
        for group, tested in _folds(takes[part], labels[part], options):
            runners, distances = group.runners([_OFFLINE]), group.accuracy.distances
            for pair, label in zip(group.tests, tested, strict=True):
                both = [distances(run(pair.take), pair.truth) for run in runners]
                found.setdefault(label, []).append(both)
    rows: list[Row] = []
    for name, parts in found.items():
        forest, liu = (mean_cm(*part) for part in zip(*parts, strict=True))
        rows.append((name, forest, liu, *_LIU_4.get(name, (None, None))))
    columns = {"forest": 1, "liu, offline": 2, "paper, forest": 3, "paper, Liu": 4}
    bars = series_of(rows, columns, kind="bars")
    title = "A tracker of depth images, corrected (Liu 2016, Table 4)"
    header = ("motion", "forest_cm", "liu_cm", "paper_forest_cm", "paper_liu_cm")
    return Study(title, header, rows, [Panel("motion", "error, cm", bars)])


def _folds(
    takes: Sequence[PairedTake], labels: Sequence[str], options: Options
) -> Iterator[tuple[Group, list[str]]]:
    """Yield a fifth of the people, with the others for training, and their labels."""
    people = list(dict.fromkeys(take.subject for take in takes))
    for k in range(min(_FOLDS, len(people))):
        held_out = np.isin([take.subject for take in takes], people[k::_FOLDS])
        train = compress(takes, ~held_out)
        trainer = CorrectorFactory(train, progress=options.progress)
        group = Group("new", [*compress(takes, held_out)], trainer)
        yield group, [*compress(labels, held_out)]


def liu_figure_7(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Vary the samples per local model, S, and the number of blended models, L.

    The paper's figure has no values; the paper chooses S = 50 and L = 9, beyond which
    its error hardly falls. The preset does not learn from the takes. A quarter as many
    people are tested as learned from; ``values`` of S and of L are tried, from the
    smallest.
    """
    groups = simulated(options, _HARD, learners=people)
    rows: list[Row] = []
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
    title = "Samples per local model, and blended models (Liu 2016, Figure 7)"
    header = ("samples_S", "blended_L", *_HEADER, "paper")
    return Study(title, header, rows, panels, across=2)


def liu_figure_8(options: Options, *, people: int = 16) -> Study:
    """Follow the left wrist of people who swing a golf club.

    The paper follows the hand, which the sensor's trackers place arbitrarily. The last
    row is that of the predicted offsets alone. A quarter as many people are tested as
    learned from.
    """
    paper = {"kinect": 12.36, _OFFLINE: 8.1, "liu-2016": 7.7, _OFFSETS_ALONE: None}
    trace = Trace("golf_swing", "WristLeft", paper)
    title = "The left wrist in a golf swing (Liu 2016, Figure 8)"
    return trace_study(options, title, [trace], people=people, sensor="v2")


def liu_table_5(
    options: Options, *, people: int = 8, count: int = 1000, clips: int = 1000
) -> Study:
    """Leave out terms of the energy where the sensor is unsure of a limb.

    The motions are those of the paper, simulated; half as many people are tested as
    learned from. For comparison, at most ``count`` recorded people are tested with a
    limb hidden, on every twentieth clip and at most ``clips``. The preset is the
    paper's, without learning from the takes.
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
        limbs = hidden_limb_errors(options, presets=[*presets], count=count, most=clips)
        for label, error in limbs.items():
            for where, value in error.items():
                row = situations.setdefault(f"recorded, {where}", {})
                row[presets.get(label, label)] = value
    names = ("raw", "none", *_TERMS)
    rows = [
        (where, *map(row.get, names), 100.0 - 100.0 * row["S+T+R"] / row["S"])
        for where, row in situations.items()
    ]
    plotted = [row for row in rows if str(row[0]).count(",") < 2]
    columns = {name: names.index(name) + 1 for name in _TERMS}
    bars = series_of(plotted, columns, kind="bars")
    title = "Terms of the energy of liu-2016 (Liu 2016, Table 5)"
    header = ("situation", *(f"{n}_cm" for n in names), "less_than_S_percent")
    return Study(title, header, rows, [Panel("terms of the energy", "error, cm", bars)])
