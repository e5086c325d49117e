"""Methods that learn: Liu 2016, figures 3 and 7 and table 5; Chiang 2017, figure 5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.lab.methods.lessons import TrainingSet
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.progress import over

from .corrected import StandardizedTake
from .doubtful_limbs import errors_in_doubt
from .study import Cell, Options, Panel, Series, Study, series_of
from .takes import first_person, performed_by

_NEW, _KNOWN = "new people", "known people"

_CLUSTERS = 30  # Q
_HARD = ("tai_chi", "bend", "cross_arms")  # the motions of table 5
_SAMPLES = (5, 10, 20, 50)  # S
_BLENDED = (1, 3, 9, 15)  # L
_CHOSEN = (50, 9)  # S and L

_WALKING = ("march",)  # on the spot: who walks leaves the sensor's view
_WALKING_SAMPLES, _WALKING_KEPT = 1120, 681
_REDUNDANCIES = (0.0, 0.02, 0.1, 0.5)

_TERMS: dict[str, tuple[dict[str, float], float]] = {
    "S": ({"temporal": 0.0, "reliability": 0.0}, 12.0),
    "S+T": ({"reliability": 0.0}, 10.5),
    "S+R": ({"temporal": 0.0}, 9.7),
    "S+T+R": ({}, 7.9),
}
"""Weights that are changed to leave out terms, and the paper's errors [cm]."""

_EXERCISE = ("push_down_pumping",)  # exercise 4, that of figure 5
_CENTROIDS = (25, 50, 100, 200, 400, 800, 1600)  # Q
_PAPER_CENTROIDS = 800
_PAPER_RAW, _PAPER_ERROR = 8.38, 2.70  # cm, of exercise 4 at that Q (table 2)


class _Experiment:
    """What methods learn from, and what they are tested on.

    Methods are tested on people whom they have not met (``new people``), and on those
    whom they learned from, in other performances of the same motions (``known
    people``). Of each group there is one for every ``share`` learners. The papers say
    nothing of people who were held back.
    """

    def __init__(
        self,
        options: Options,
        motions: Sequence[str],
        *,
        learners: int,
        share: int,
        sensor: str = "v2",
    ) -> None:
        first, new = (first_person(options.seed, learners=who) for who in (True, False))
        testers, progress = max(learners // share, 1), options.progress
        record = partial(
            performed_by, motions=motions, sensor=sensor, progress=progress
        )
        taught = record(range(first, first + learners))
        self.training = training_set(over(taught, "standardize", progress))
        strangers = record(range(new, new + testers))
        known = record(range(first, first + testers), again=True)
        self.tests = [[*map(StandardizedTake, pairs)] for pairs in (strangers, known)]

    def errors(self, method: LearnedCorrector | None) -> tuple[float, float]:
        """Return the mean error on new and on known people [cm]; None: of raw takes."""
        distances = [[test.distances(method) for test in tests] for tests in self.tests]
        new, known = (100.0 * np.nanmean(np.concatenate(part)) for part in distances)
        return float(new), float(known)


def liu_figure_3(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Drop the samples of walking that their neighbors predict (posture budgeting).

    From 1120 samples, as in the paper, where 681 of them do about as well. They are
    dropped joint by joint: the count is the mean over joints. Error is that of the
    predicted offsets alone. Half as many people are tested as walk for the method to
    learn; ``values`` of the thresholds are tried, from the one that drops nothing.
    """
    experiment = _Experiment(options, _WALKING, learners=people, share=2)
    training = _drawn(experiment.training, _WALKING_SAMPLES)
    rows: list[tuple[Cell, ...]] = []
    for redundancy in _REDUNDANCIES[:values]:
        method = LocalGP(
            training.skeleton,
            clusters=16,
            samples=200,  # so many that no model is full
            blended=3,
            redundancy=redundancy,
        )
        method = method.fit(training, progress=options.progress)
        method = method.adjusted(**_TERMS["S"][0])
        count = float(method.counts_.sum() / len(method.joints_))
        paper = None if rows else _WALKING_SAMPLES
        rows.append((redundancy, count, *experiment.errors(method), paper))
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


def _drawn(training: TrainingSet, count: int) -> TrainingSet:
    """Return some frames of a training set, drawn at random."""
    rows = np.random.default_rng(0).permutation(len(training))[:count]
    names = ("positions", "reliability", "truth", "lengths")
    drawn = {name: getattr(training, name)[rows] for name in names}
    return replace(training, first=np.ones(len(rows), dtype=bool), **drawn)


def liu_figure_7(options: Options, *, people: int = 8, values: int = 4) -> Study:
    """Vary the samples of a local model, S, and the local models blended, L.

    The paper's figure is printed without its values; it chooses S = 50 and L = 9,
    beyond which its error hardly falls. A quarter as many people are tested as perform
    for the method to learn; ``values`` of S and of L are tried, from the smallest.
    """
    experiment = _Experiment(options, _HARD, learners=people, share=4)
    training, progress = experiment.training, options.progress
    rows: list[tuple[Cell, ...]] = []
    for samples in _SAMPLES[:values]:
        method = LocalGP(training.skeleton, clusters=_CLUSTERS, samples=samples)
        method.fit(training, progress=progress)
        for blended in over(_BLENDED[:values], f"S = {samples}", progress):
            method.blended = blended
            paper = "chosen" if (samples, blended) == _CHOSEN else None
            rows.append((samples, blended, *experiment.errors(method), paper))
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


def liu_table_5(
    options: Options, *, people: int = 8, count: int = 1000, clips: int = 1000
) -> Study:
    """Leave out terms of the energy where the sensor is in doubt of a limb.

    On simulated tai chi, bending over and crossing arms, as in the paper; half as many
    people are tested as perform for the method to learn. On at most ``count`` recorded
    people, of whom every twentieth clip, at most ``clips``, is tested with a limb
    hidden. The preset is the paper's, but that it does not learn from the takes.
    """
    experiment = _Experiment(options, _HARD, learners=people, share=2)
    config = CleanConfig(preset="liu-2016", set=("adapt=false",))
    method = LocalGP(experiment.training.skeleton, **config.parameters.method)
    method.fit(experiment.training, progress=options.progress)
    errors = {"raw": experiment.errors(None)}
    labels = {}
    for name, (terms, _) in over([*_TERMS.items()], "terms", options.progress):
        errors[name] = experiment.errors(method.adjusted(**terms))
        left_out = "".join(f":{term}={weight:g}" for term, weight in terms.items())
        labels[f"liu-2016:adapt=false{left_out}"] = name
    situations = {"the paper": {name: paper for name, (_, paper) in _TERMS.items()}}
    for k, who in enumerate((_NEW, _KNOWN)):
        situations[f"simulated {who}"] = {n: pair[k] for n, pair in errors.items()}
    if options.data is not None:
        for label, found in errors_in_doubt(
            options, [*labels], count=count, most=clips
        ).items():
            for where, error in found.items():
                row = situations.setdefault(f"recorded, {where}", {})
                row[labels.get(label, label)] = error
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


def chiang_figure_5(options: Options, *, people: int = 40, values: int = 7) -> Study:
    """Vary the number of centroids that the process is on, for one exercise.

    The paper tests on the people whom it learned from, and assumes standard lengths;
    here all have their own. Its errors over Q are a plot without values; its table 2
    has those of Q = 800. An eighth as many people are tested as perform for the method
    to learn; ``values`` of Q are tried, from the smallest.
    """
    # A v2's thumbs leave too few frames with every joint reliable.
    experiment = _Experiment(options, _EXERCISE, learners=people, share=8, sensor="v1")
    tests = [test for group in experiment.tests for test in group]
    frames = sum(len(test.positions) for test in tests)
    new, known = experiment.errors(None)
    rows: list[tuple[Cell, ...]] = [("raw", new, known, None, _PAPER_RAW)]
    for count in over(_CENTROIDS[:values], "centroids", options.progress):
        method = ClusteredGP(experiment.training.skeleton, centroids=count)
        method.fit(experiment.training)
        start = perf_counter()
        errors = experiment.errors(method)
        milliseconds = 1e3 * (perf_counter() - start) / frames
        paper = _PAPER_ERROR if count == _PAPER_CENTROIDS else None
        rows.append((count, *errors, milliseconds, paper))
    errors_of = [
        *series_of(rows[1:], {_NEW: 1, _KNOWN: 2}),
        Series(f"{_NEW}, raw", (), [new], "level"),
        Series(f"{_KNOWN}, raw", (), [known], "level"),
        Series("paper, Q = 800", (), [_PAPER_ERROR], "level"),
    ]
    times = series_of(rows[1:], {"clustered-gp": 3})
    label = "centroids Q (the paper chooses 800)"
    return Study(
        title="Centroids of the clustered process (Chiang 2017, Figure 5)",
        columns=("centroids_Q", "new_people_cm", "known_people_cm", "ms", "paper_cm"),
        rows=rows,
        panels=[
            Panel(label, "error, cm", errors_of, log_x=True),
            Panel(label, "ms a frame", times, log_x=True),
        ],
        across=2,
    )
