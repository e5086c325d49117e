"""How long the nearest of up to a million postures take to find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database.posture_database import PostureIndex
from kinefilter.pipeline.lab.evaluate import observed
from kinefilter.pipeline.lab.scripted_database import scripted_postures
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.spool import Spool

from .study import Panel, Series, Study

Postures = NDArray[np.float32]
_Query = tuple[Array, Array]

_SIZES = (2_500, 10_000, 40_000, 160_000, 1_000_000)
_PEOPLE = 78  # who perform a million postures
_NEIGHBORS = 5  # as local PCA looks for
_MOTIONS = ("walk", "punch", "squat", "tai_chi", "lift_box", "sit")
_FIRST = 500  # seed of those who are searched for; below are those who are found
_EVERY = 7  # frames between queries
_CHECKED = 10  # queries to one that is compared with all postures
_TURNS = 3  # the best of which counts


def million_postures(
    *,
    seed: int = 0,
    values: int = 5,
    people: int = _PEOPLE,
    progress: Progress = silent,
) -> Study:
    """Look for the nearest postures of frames of simulated Kinect takes.

    Postures are those of scripted performances, put aside on a disk as a database is
    built; takes are of other people. Every tenth answer of the largest is compared with
    the distances of all postures in double precision.

    Args:
        seed: Draws those whose postures are searched for.
        values: How many of the sizes, from the smallest.
        people: Who perform the postures that are searched.
        progress: Wraps the loops, for a progress bar.
    """
    asked, postures = _queries(_FIRST + seed), _postures(people, progress)
    sizes = _SIZES[:values]
    rows = []
    for k in progress("search", len(sizes)):
        part = postures[: sizes[k]]
        index, whole = PostureIndex(part), _Whole(part)
        times = (_milliseconds(find, asked) for find in (_nearest(index), whole))
        a, b = (np.percentile(t, [50, 99]).tolist() for t in times)
        rows.append((len(part), *a, *b, b[0] / a[0], _exact(index, part, asked)))
    x = [float(row[0]) for row in rows]
    names = ("boxes", "boxes, 99 %", "product", "product, 99 %")
    lines = (Series(name, x, [r[1 + k] for r in rows]) for k, name in enumerate(names))
    return Study(
        name="million-postures",
        title="The nearest of many postures",
        columns=(
            *("postures", "median_ms", "ms_of_99_percent", "product_median_ms"),
            *("product_ms_of_99_percent", "times_faster", "exact_percent"),
        ),
        rows=tuple(rows),
        panels=(Panel("postures", "ms a query", tuple(lines), log_x=True, log_y=True),),
    )


def _postures(people: int, progress: Progress) -> Postures:
    """Return the postures of a number of people, in random order, (N, J, 3) [m]."""
    spool = Spool(np.float32)
    for _, positions, _ in scripted_postures(KINECT_V1, progress, people=people):
        spool.add(positions)
    order = np.random.default_rng(0).permutation(len(spool))[: _SIZES[-1]]
    return np.asarray(spool.array()[order])


def _queries(first: int) -> list[_Query]:
    """Return postures [m] and rates of people whom a simulated Kinect v1 sees."""
    found: list[_Query] = []
    for k, motion in enumerate(_MOTIONS):
        take = observed(simulate("basic", motion, sensor="v1", seed=first + k))
        rates = np.where(np.isnan(take.positions[..., 0]), 0.0, take.reliability.rate)
        found += list(zip(take.positions, rates, strict=True))[::_EVERY]
    return found


class _Whole:
    """Looks at all postures: one matrix product, then the smallest.

    Args:
        postures: What is searched [m], shape (N, J, 3).
    """

    def __init__(self, postures: Postures) -> None:
        squares = np.sum(postures**2, axis=2)
        flat = postures.reshape(len(postures), -1)
        self._products = np.concatenate([squares, -2.0 * flat], axis=1)

    def __call__(self, query: _Query) -> NDArray[np.intp]:
        """Return the nearest, in no order."""
        posture, rate = query
        seen = np.where(rate[:, None] > 0.0, posture, 0.0)
        asked = np.concatenate([rate, (rate[:, None] * seen).ravel()])
        away = self._products @ asked.astype(np.float32)
        return np.argpartition(away, _NEIGHBORS - 1)[:_NEIGHBORS]


def _nearest(index: PostureIndex) -> Callable[[_Query], object]:
    return lambda query: index.nearest(*query, _NEIGHBORS)


def _milliseconds(find: Callable[[_Query], object], asked: Sequence[_Query]) -> Array:
    """Return how long each query takes, shape (len(asked),)."""
    times = np.empty((_TURNS, len(asked)))
    for turn in range(_TURNS):
        for k, query in enumerate(asked):
            start = perf_counter()
            find(query)
            times[turn, k] = perf_counter() - start
    return np.asarray(times.min(axis=0) * 1e3)


def _exact(index: PostureIndex, postures: Postures, asked: Sequence[_Query]) -> float:
    """Return how many of the answers are right [%], of every tenth query."""
    right = []
    for posture, rate in asked[::_CHECKED]:
        distances = np.zeros(len(postures))
        for j in np.flatnonzero(rate):
            away = postures[:, j] - posture[j]
            distances += rate[j] * np.vecdot(away, away)
        expected = np.sort(np.partition(distances, _NEIGHBORS)[:_NEIGHBORS])
        found = index.nearest(posture, rate, _NEIGHBORS)[1]
        right.append(np.allclose(found, expected, rtol=1e-12, atol=1e-12))
    return 100.0 * float(np.mean(right))
