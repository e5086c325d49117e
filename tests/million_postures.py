"""How long the nearest of 2,500 to 1,000,000 postures take to find, drawn and printed.

    python tests/million_postures.py growth.png

Postures are those of scripted performances, of some eighty people, put aside on a disk
as a database is built; queries are frames of simulated Kinect takes of other people, as
``clean`` searches for them. Every answer of the largest is compared with that of the
whole matrix product.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.commands.terminal import out, progress_bars
from kinefilter.pipeline.evaluate import observed
from kinefilter.pipeline.library import scripted_postures
from kinefilter.pipeline.posture_index import PostureIndex
from kinefilter.pipeline.simulate import simulate
from kinefilter.pipeline.spool import Spool
from kinefilter.pipeline.workers import one_thread

Array = NDArray[np.float64]
Query = tuple[Array, Array]

SIZES = (2_500, 10_000, 40_000, 160_000, 1_000_000)
PEOPLE = 78  # who perform a million postures
NEIGHBORS = 5  # as local PCA looks for
MOTIONS = ("walk", "punch", "squat", "tai_chi", "lift_box", "sit")
EVERY = 7  # frames between queries


def postures() -> NDArray[np.float32]:
    """Return a million postures, in random order."""
    spool = Spool(np.float32)
    with progress_bars() as progress:
        for _, positions, _ in scripted_postures(KINECT_V1, progress, people=PEOPLE):
            spool.add(positions)
    order = np.random.default_rng(0).permutation(len(spool))[: SIZES[-1]]
    return np.asarray(spool.array()[order])


def queries() -> list[Query]:
    """Return postures and rates of people whom a simulated Kinect v1 sees."""
    found = []
    for k, motion in enumerate(MOTIONS):
        pair = simulate("basic", motion, sensor="v1", seed=500 + k)
        take = observed(pair)
        rates = np.where(np.isnan(take.positions[..., 0]), 0.0, take.reliability.rate)
        found += list(zip(take.positions, rates, strict=True))[::EVERY]
    return found


def milliseconds(find: Callable[[Query], object], asked: list[Query]) -> Array:
    """Return how long each query takes, the best of three."""
    times = np.empty((3, len(asked)))
    for turn in range(3):
        for k, query in enumerate(asked):
            start = time.perf_counter()
            find(query)
            times[turn, k] = time.perf_counter() - start
    return np.asarray(times.min(axis=0) * 1e3)


class Whole:
    """Looks at all postures: one matrix product, then the smallest."""

    def __init__(self, positions: NDArray[np.float32]) -> None:
        squares = np.sum(positions**2, axis=2)
        flat = positions.reshape(len(positions), -1)
        self._products = np.concatenate([squares, -2.0 * flat], axis=1)

    def __call__(self, query: Query) -> NDArray[np.intp]:
        """Return the nearest, in no order."""
        posture, rate = query
        seen = np.where(rate[:, None] > 0.0, posture, 0.0)
        asked = np.concatenate([rate, (rate[:, None] * seen).ravel()])
        away = self._products @ asked.astype(np.float32)
        return np.argpartition(away, NEIGHBORS - 1)[:NEIGHBORS]


def main() -> None:
    """Measure, check, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("picture", type=Path, help="PNG to write")
    options = parser.parse_args()
    with one_thread():
        asked = queries()
        table = measured(postures(), asked)
    draw(table, options.picture)


def measured(positions: NDArray[np.float32], asked: list[Query]) -> Array:
    """Print a line for each size; return size, index and whole, median and 99 %."""
    rows = []
    for size in SIZES:
        start = time.perf_counter()
        index, whole = PostureIndex(positions[:size]), Whole(positions[:size])
        built = time.perf_counter() - start
        a = milliseconds(lambda q: index.nearest(*q, NEIGHBORS), asked)  # noqa: B023
        b = milliseconds(whole, asked)
        rows.append([size, *np.percentile(a, [50, 99]), *np.percentile(b, [50, 99])])
        out.print(
            f"{size:9,d} postures: {rows[-1][1]:6.2f} ms median, {rows[-1][2]:6.2f} ms "
            f"99 %; all of them {rows[-1][3]:6.2f} and {rows[-1][4]:6.2f} ms; "
            f"both built in {built:.1f} s"
        )
    check(positions, index, asked)
    return np.array(rows)


def check(
    positions: NDArray[np.float32], index: PostureIndex, asked: list[Query]
) -> None:
    """Compare the distances found with those of all postures in double precision."""
    for posture, rate in asked[::10]:
        distances = np.zeros(len(positions))
        for j in np.flatnonzero(rate):
            away = positions[:, j] - posture[j]
            distances += rate[j] * np.vecdot(away, away)
        expected = np.sort(np.partition(distances, NEIGHBORS)[:NEIGHBORS])
        found = index.nearest(posture, rate, NEIGHBORS)[1]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    out.print(f"{len(asked[::10])} of {len(asked)} answers compared: exact")


def draw(table: Array, path: Path) -> None:
    """Draw both against the number of postures."""
    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    size = table[:, 0]
    for k, (name, color) in enumerate((("blocks", "C0"), ("all of them", "C1"))):
        median, most = table[:, 1 + 2 * k], table[:, 2 + 2 * k]
        axes.loglog(size, median, "o-", color=color, label=f"{name}, median")
        axes.loglog(size, most, "--", color=color, lw=1, label=f"{name}, 99 %")
    axes.axhline(20.0, color="0.6", lw=1)
    axes.set(xlabel="postures", ylabel="ms a query")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
