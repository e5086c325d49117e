"""Local mixtures of Gaussian processes: Liu 2016, figures 3 and 7, table 5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinefilter.pipeline.correct import TrainingSet
from kinefilter.pipeline.correct.local_gp import LocalGP
from kinefilter.pipeline.progress import Progress, silent

from .learned import GROUPS, School
from .study import Cell, Panel, Series, Study

_CLUSTERS = 30  # Q
_HARD = ("tai_chi", "bend", "cross_arms")  # the motions of table 5
_SAMPLES = (5, 10, 20, 50)  # S
_BLENDED = (1, 3, 9, 15)  # L
_CHOSEN = (50, 9)  # S and L

_WALKING = ("march",)  # on the spot: who walks leaves the sensor's view
_WALKING_SAMPLES, _WALKING_KEPT = 1120, 681
_WALKING_CLUSTERS, _WALKING_LARGEST = 16, 200  # so that no model is full
_WALKING_BLENDED = 3
_REDUNDANCIES = (0.0, 0.02, 0.1, 0.5)

_PAPER_TERMS = (12.0, 10.5, 9.7, 7.9)  # cm
_TERMS: dict[str, dict[str, float]] = {
    "S": {"temporal": 0.0, "reliability": 0.0},
    "S+T": {"reliability": 0.0},
    "S+R": {"temporal": 0.0},
    "S+T+R": {},
}


def liu_figure_3(
    *, seed: int = 0, people: int = 8, values: int = 4, progress: Progress = silent
) -> Study:
    """Drop the samples of walking that their neighbors predict (posture budgeting).

    From 1120 samples, as in the paper, where 681 of them do about as well. They are
    dropped joint by joint: the count is the mean over joints. Error is that of the
    predicted offsets alone.

    Args:
        seed: Draws people, performances and the sensor's errors.
        people: Who walks for the method to learn; half as many test it.
        values: How many thresholds, from that which drops nothing.
        progress: Wraps the loops, for a progress bar.
    """
    testers = max(people // 2, 1)
    school = School.opened(
        _WALKING, learners=people, testers=testers, seed=seed, progress=progress
    )
    lessons = _drawn(school.lessons, _WALKING_SAMPLES)
    rows: list[tuple[float, float, float, float]] = []
    for redundancy in _REDUNDANCIES[:values]:
        method = LocalGP(
            lessons.skeleton,
            clusters=_WALKING_CLUSTERS,
            samples=_WALKING_LARGEST,
            blended=_WALKING_BLENDED,
            redundancy=redundancy,
        )
        method = method.fit(lessons, progress=progress).with_terms(**_TERMS["S"])
        count = float(method.counts_.sum() / len(method.joints_))
        rows.append((redundancy, count, *school.errors(method)))
    kept = [row[1] for row in rows]
    return Study(
        name="liu-figure-3",
        title="Posture budgeting: samples kept against error (Liu 2016, Figure 3)",
        columns=(
            *("redundancy", "samples_kept", "new_people_cm", "known_people_cm"),
            "paper_samples_kept",
        ),
        rows=(
            (*rows[0], _WALKING_SAMPLES),
            *((*row, None) for row in rows[1:]),
            ("paper", None, None, None, _WALKING_KEPT),
        ),
        panels=(
            Panel(
                "samples kept (paper: 681 of 1120 at about the same error)",
                "error, cm",
                tuple(
                    Series(group, kept, [row[2 + k] for row in rows])
                    for k, group in enumerate(GROUPS)
                ),
            ),
        ),
    )


def _drawn(lessons: TrainingSet, count: int) -> TrainingSet:
    """Return some frames of a training set, drawn at random."""
    rows = np.random.default_rng(0).permutation(len(lessons))[:count]
    lengths = lessons.lengths
    return replace(
        lessons,
        positions=lessons.positions[rows],
        rate=lessons.rate[rows],
        truth=lessons.truth[rows],
        first=np.ones(len(rows), dtype=bool),
        lengths=None if lengths is None else lengths[rows],
    )


def liu_figure_7(
    *, seed: int = 0, people: int = 8, values: int = 4, progress: Progress = silent
) -> Study:
    """Vary the samples of a local model, S, and the local models blended, L.

    The paper's figure is printed without its values; it chooses S = 50 and L = 9, from
    where on its error hardly falls.

    Args:
        seed: Draws people, performances and the sensor's errors.
        people: Who performs for the method to learn; a quarter as many test it.
        values: How many values of S and of L, from the smallest.
        progress: Wraps the loops, for a progress bar.
    """
    testers = max(people // 4, 1)
    school = School.opened(
        _HARD, learners=people, testers=testers, seed=seed, progress=progress
    )
    rows: list[tuple[int, int, float, float]] = []
    for samples in _SAMPLES[:values]:
        method = LocalGP(school.lessons.skeleton, clusters=_CLUSTERS, samples=samples)
        method.fit(school.lessons, progress=progress)
        for k in progress(f"S = {samples}", len(_BLENDED[:values])):
            method.blended = _BLENDED[k]
            rows.append((samples, _BLENDED[k], *school.errors(method)))
    return Study(
        name="liu-figure-7",
        title="Samples a local model, and models blended (Liu 2016, Figure 7)",
        columns=(
            *("samples_S", "blended_L", "new_people_cm", "known_people_cm"),
            "paper",
        ),
        rows=tuple((*row, "chosen" if row[:2] == _CHOSEN else None) for row in rows),
        panels=tuple(
            Panel(
                f"L, {group} (the paper chooses S = 50, L = 9)",
                "error, cm",
                tuple(_over_blended(rows, samples, k) for samples in _SAMPLES[:values]),
                zero=False,
            )
            for k, group in enumerate(GROUPS)
        ),
        across=2,
    )


def _over_blended(
    rows: Sequence[tuple[int, int, float, float]], samples: int, group: int
) -> Series:
    """Return a group's errors over L at one S."""
    own = [row for row in rows if row[0] == samples]
    return Series(
        f"S = {samples}",
        [float(row[1]) for row in own],
        [row[2 + group] for row in own],
    )


def liu_table_5(
    *, seed: int = 0, people: int = 8, progress: Progress = silent
) -> Study:
    """Leave out terms of the energy, on tai chi, bending over and crossing arms.

    Args:
        seed: Draws people, performances and the sensor's errors.
        people: Who performs for the method to learn; half as many test it.
        progress: Wraps the loops, for a progress bar.
    """
    testers = max(people // 2, 1)
    school = School.opened(
        _HARD, learners=people, testers=testers, seed=seed, progress=progress
    )
    method = LocalGP(school.lessons.skeleton, clusters=_CLUSTERS)
    method.fit(school.lessons, progress=progress)
    raw, errors, names = school.errors(None), [], list(_TERMS)
    for k in progress("terms", len(names)):
        errors.append(school.errors(method.with_terms(**_TERMS[names[k]])))
    rows: list[tuple[Cell, ...]] = [("raw", *raw, None)]
    for name, error, paper in zip(names, errors, _PAPER_TERMS, strict=True):
        rows.append((name, *error, paper))
    return Study(
        name="liu-table-5",
        title="Terms of the energy of local-gp (Liu 2016, Table 5)",
        columns=("terms", "new_people_cm", "known_people_cm", "paper_cm"),
        rows=tuple(rows),
        panels=(
            Panel(
                "terms of the energy",
                "error, cm",
                (
                    *(
                        Series(group, names, [e[k] for e in errors], "bars")
                        for k, group in enumerate(GROUPS)
                    ),
                    Series("paper", names, _PAPER_TERMS, "bars", paper=True),
                ),
            ),
        ),
    )
