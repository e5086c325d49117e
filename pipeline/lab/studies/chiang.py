"""A Gaussian process on cluster centroids: Chiang 2017, figure 5."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

from kinefilter.pipeline.lab.methods.clustered_gp import ClusteredGP
from kinefilter.pipeline.progress import Progress, silent

from .learned import GROUPS, School
from .study import Cell, Panel, Series, Study

_EXERCISE = ("push_down_pumping",)  # exercise 4, that of figure 5
_SENSOR = "v1"  # a v2's thumbs leave too few frames with every joint reliable
_TESTED = 8  # learners to one who is tested on
_CENTROIDS = (25, 50, 100, 200, 400, 800, 1600)  # Q
_PAPER_CHOICE = 800
_PAPER_RAW, _PAPER_ERROR = 8.38, 2.70  # cm, of exercise 4 at that choice (table 2)


def chiang_figure_5(
    *, seed: int = 0, people: int = 40, values: int = 7, progress: Progress = silent
) -> Study:
    """Vary the centroids that the process is on, for one exercise.

    The paper tests on the people whom it learned from, and counts on standard lengths;
    here everybody has their own. Its errors over Q are a plot without values; its table
    2 has those of Q = 800.

    Args:
        seed: Draws people, performances and the sensor's errors.
        people: Who performs for the method to learn; an eighth as many test it.
        values: How many values of Q, from the smallest.
        progress: Wraps the loops, for a progress bar.
    """
    school = School.opened(
        _EXERCISE,
        learners=people,
        testers=max(people // _TESTED, 1),
        seed=seed,
        sensor=_SENSOR,
        progress=progress,
    )
    groups = school.tested.values()
    frames = sum(len(pair.take) for group in groups for pair, _ in group)
    raw, counts = school.errors(None), _CENTROIDS[:values]
    found: list[tuple[float, float, float]] = []
    for k in progress("centroids", len(counts)):
        method = ClusteredGP(school.lessons.skeleton, centroids=counts[k])
        method.fit(school.lessons)
        start = perf_counter()
        errors = school.errors(method)
        found.append((*errors, 1e3 * (perf_counter() - start) / frames))
    rows: list[tuple[Cell, ...]] = [("raw", *raw, None, _PAPER_RAW)]
    for count, figures in zip(counts, found, strict=True):
        paper = _PAPER_ERROR if count == _PAPER_CHOICE else None
        rows.append((count, *figures, paper))
    return Study(
        name="chiang-figure-5",
        title="Centroids of the clustered process (Chiang 2017, Figure 5)",
        columns=("centroids_Q", "new_people_cm", "known_people_cm", "ms", "paper_cm"),
        rows=tuple(rows),
        panels=_panels(raw, counts, found),
        across=2,
    )


def _panels(
    raw: tuple[float, float],
    counts: Sequence[int],
    found: Sequence[tuple[float, float, float]],
) -> tuple[Panel, Panel]:
    """Return error and time over the centroids."""
    x = [float(count) for count in counts]
    lines = [
        Series(group, x, [figures[k] for figures in found])
        for k, group in enumerate(GROUPS)
    ]
    levels = [
        Series(f"{group}, raw", (), [raw[k]], "level") for k, group in enumerate(GROUPS)
    ]
    paper = Series("paper, Q = 800", (), [_PAPER_ERROR], "level", paper=True)
    label = "centroids Q (the paper chooses 800)"
    times = Series("clustered-gp", x, [figures[2] for figures in found])
    return (
        Panel(label, "error, cm", (*lines, *levels, paper), log_x=True),
        Panel(label, "ms a frame", (times,), log_x=True),
    )
