"""What the parameters of local PCA are worth: Shum 2013, table V and figure 8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np

from kinefilter.characters import KINECT_V1
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import LocalPCA
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.database.threshold_rule import filter_to_count
from kinefilter.pipeline.lab.evaluate import observed
from kinefilter.pipeline.lab.scripted_database import scripted_postures
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.standard import StandardTake

from .bone_errors import bone_errors
from .study import Cell, Panel, Series, Study
from .takes import people_of, performed_by

Search = Literal["stochastic", "solver"]

_MOTIONS = ("cross_arms", "squat", "punch", "tai_chi", "wave")
_FRAMES = 60  # of each take: 2 s
_VALUES: dict[str, tuple[int, ...]] = {
    "postures": (50, 200, 500, 1000, 2574, 5000, 10000),
    "neighbors": (5, 10, 20, 30, 60, 120),
    "dimensions": (2, 5, 10, 20, 29),
    "steps": (1, 5, 10, 20, 40),
    "samples": (5, 20, 50, 100, 200),
}
_OF_SAMPLING = ("steps", "samples")
_FIGURES = ("energy_m2", "error_cm", "ms")


@dataclass(frozen=True)
class _Parameters:
    """Table V; each field is one panel column of figure 8."""

    postures: int = 2574
    neighbors: int = 30
    dimensions: int = 20
    steps: int = 20
    samples: int = 100


@dataclass(frozen=True)
class _Row:
    """One point of the figure."""

    parameter: str
    value: int
    search: Search
    figures: tuple[float, float, float]
    """Energy [m^2], error [cm], time [ms]."""


def shum_figure_8(
    *,
    seed: int = 0,
    motions: int = 5,
    values: int = 7,
    progress: Progress = silent,
) -> Study:
    """Vary one parameter after the other, the rest as in Table V.

    The paper's search samples (``stochastic``); kinefilter's solver has no steps and no
    samples to choose, and is a level there. Energy is that of the posture found (lower
    is better; the paper plots a score, which rises), error is eq. 18 of that posture
    alone, on the person's own lengths; time is that of neighbors, posture space and
    search, the median frame's.

    Args:
        seed: Draws people, performances and the sensor's errors.
        motions: How many of five takes of 2 s.
        values: Most values of each parameter.
        progress: Wraps the loops, for a progress bar.
    """
    takes = []
    for k in range(motions):
        (pair,) = performed_by([people_of(seed) + k], [_MOTIONS[k]], sensor="v1")
        takes.append((observed(pair), pair.truth))
    chosen = {name: _spread(choices, values) for name, choices in _VALUES.items()}
    databases = _databases({*chosen["postures"], _Parameters.postures}, progress)

    def measure(search: Search, **parameter: int) -> tuple[float, float, float]:
        settings = _Parameters(**parameter)
        method = LocalPCA(
            databases[settings.postures],
            neighbors=settings.neighbors,
            dimensions=settings.dimensions,
            search=search,
            steps=settings.steps,
            samples=settings.samples,
        )
        return _measure(method, takes)

    solved = measure("solver")
    rows = []
    for name, choices in chosen.items():
        for k in progress(name, len(choices)):
            value = choices[k]
            sampled = measure("stochastic", **{name: value})
            rows.append(_Row(name, value, "stochastic", sampled))
            own = solved if name in _OF_SAMPLING else measure("solver", **{name: value})
            rows.append(_Row(name, value, "solver", own))
    return _as_study(rows)


def _spread(choices: Sequence[int], count: int) -> list[int]:
    """Return some of the choices, the first among them."""
    count = min(count, len(choices))
    return [choices[k * len(choices) // count] for k in range(count)]


def _databases(sizes: set[int], progress: Progress) -> dict[int, PostureDatabase]:
    """Return the scripted postures, filtered to about each of some sizes."""
    shipped = builtin_database(KINECT_V1)
    smaller = {size: shipped for size in sizes if size <= len(shipped)}
    larger = sizes - set(smaller)
    whole = _unfiltered(progress) if larger else shipped
    found = {}
    order = sorted(sizes)
    for k in progress("filter", len(order)):
        source = smaller.get(order[k], whole)
        kept = filter_to_count(source.positions, order[k])
        found[order[k]] = PostureDatabase(
            source.positions[kept],
            source.rotations[kept],
            source.labels[kept],
            KINECT_V1,
        )
    return found


def _unfiltered(progress: Progress) -> PostureDatabase:
    """Return every posture of the scripted performances."""
    labels, postures, rotations = zip(
        *scripted_postures(KINECT_V1, progress), strict=True
    )
    counts = [len(part) for part in postures]
    return PostureDatabase(
        np.concatenate(postures),
        np.concatenate(rotations),
        np.repeat(labels, counts),
        KINECT_V1,
    )


def _measure(
    method: LocalPCA, takes: Sequence[tuple[StandardTake, Array]]
) -> tuple[float, float, float]:
    """Return energy [m^2], error [cm] and time a frame [ms]."""
    energies, seconds, errors = [], [], []
    for take, truth in takes:
        method.start()
        seen, rate = take.positions, take.reliability.rate
        made = take.positions.copy()
        for k in range(min(_FRAMES, len(seen))):
            trusted = np.where(np.isnan(seen[k, :, 0]), 0.0, rate[k])
            start = perf_counter()
            made[k] = method.synthesize(seen[k], trusted)[0]
            seconds.append(perf_counter() - start)
            energies.append(float(method.energy(made[k].reshape(1, -1))[0]))
        back = take.undo(made)[:_FRAMES]
        errors.append(bone_errors(back, truth[:_FRAMES], KINECT_V1))
    error = float(np.concatenate(errors).mean())
    return float(np.mean(energies)), 100.0 * error, 1e3 * float(np.median(seconds))


def _as_study(rows: list[_Row]) -> Study:
    """Return table and plot: a row of panels each for energy, error and time."""
    panels = [
        Panel(name, label, _lines(rows, name, k), log_x=True, zero=k == 2)
        for k, label in enumerate(("energy, m²", "error (eq. 18), cm", "ms a frame"))
        for name in _VALUES
    ]
    cells: list[tuple[Cell, ...]] = [
        (
            row.parameter,
            row.value,
            row.search,
            *row.figures,
            getattr(_Parameters, row.parameter),
        )
        for row in rows
    ]
    return Study(
        name="shum-figure-8",
        title="Parameters of local PCA (Shum 2013, Table V and Figure 8)",
        columns=("parameter", "value", "search", *_FIGURES, "paper_chosen_value"),
        rows=tuple(cells),
        panels=tuple(panels),
        across=len(_VALUES),
    )


def _lines(rows: list[_Row], name: str, figure: int) -> tuple[Series, ...]:
    """Return the two searches' lines of one panel."""
    series = []
    for search in ("stochastic", "solver"):
        own = [row for row in rows if (row.parameter, row.search) == (name, search)]
        x = [float(row.value) for row in own]
        y = [row.figures[figure] for row in own]
        level = search == "solver" and name in _OF_SAMPLING
        series.append(Series(search, x, y, "level" if level else "line"))
    return tuple(series)
