"""Time per frame, and of nearest-neighbor search in a million postures."""

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database import PostureIndex
from kinefilter.pipeline.lab.bench import bench
from kinefilter.pipeline.lab.database_build import scripted_postures
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.spool import Spool
from kinefilter.pipeline.progress import Progress, over

from .study import Options, Panel, Study, series_of
from .study_takes import standardized

Postures = NDArray[np.float32]
_Query = tuple[Array, Array]  # a posture (J, 3) [m], and reliabilities (J,)
_STAGES = ("reliability", "correct", "orientation", "physics", "total")
_SIZES = (2_500, 10_000, 40_000, 160_000, 1_000_000)
_PEOPLE = 78  # they perform a million postures
_NEIGHBORS = 5  # as for local PCA
_MOTIONS = ("walk", "punch", "squat", "tai_chi", "lift_box", "sit")
_FIRST = 500  # first seed of people in queries, above those in the database
_EVERY = 7  # frames between queries
_CHECKED = 10  # one in this many queries is checked against all postures
_REPEATS = 3  # the fastest counts


def speed(options: Options, *, rounds: int = 3) -> Study:
    """Time every stage on the sample take, frame by frame on one core.

    Figures are medians of ``kinefilter bench`` over ``rounds``; ratios are formed
    within a round, because a machine's speed varies. The seed has no effect.
    """
    runs = [_figures() for _ in options.progress("time", rounds)]
    medians = {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
    rows = [*medians.items()]
    bars = series_of(rows[: len(_STAGES)], {"stages": 1}, x=_STAGES, kind="bars")
    panels = [Panel("stage", "ms per frame", bars)]
    return Study("Speed, frame by frame on one core", ("what", "value"), rows, panels)


def _figures() -> dict[str, float]:
    timed = bench()
    stages, search, offline = timed["ms_per_frame"], timed["search"], timed["offline"]
    bare = timed["mj_step_ms_per_frame"]
    lower = 100.0 * search["share_of_frames_lower_energy"]
    return {
        **{f"{stage}, ms a frame": stages[stage] for stage in _STAGES},
        "mj_step alone, ms a frame": bare,
        "physics over mj_step": stages["physics"] / bare,
        "all stages over mj_step": stages["total"] / bare,
        "sampling over solver": search["times_faster"],
        "frames with lower energy than sampling, %": lower,
        "cores": offline["cores"],
        "whole takes, frames a second": offline["frames_per_second"],
    }


def million_postures(
    options: Options, *, values: int = 5, people: int = _PEOPLE
) -> Study:
    """Find the nearest postures of frames of simulated Kinect takes.

    The postures are those of scripted performances by ``people``; the takes are of
    others. ``values`` of the sizes are searched, from the smallest. Every tenth answer
    is compared with the distances of all postures in double precision.
    """
    queries = _queries(_FIRST + options.seed)
    postures = _postures(people, options.progress)
    rows = []
    for size in over(_SIZES[:values], "search", options.progress):
        part = postures[:size]
        index, product = PostureIndex(part), _product_search(part)
        ours = _milliseconds(lambda q: index.nearest(*q, _NEIGHBORS), queries)  # noqa: B023
        theirs = _milliseconds(product, queries)
        share = _exact(index, part, queries)
        rows.append((len(part), *ours, *theirs, theirs[0] / ours[0], share))
    columns = {"boxes": 1, "boxes, 99 %": 2, "product": 3, "product, 99 %": 4}
    lines = series_of(rows, columns)
    panels = [Panel("postures", "ms per query", lines, log_x=True, log_y=True)]
    title = "Nearest-neighbor search in many postures"
    header = (
        *("postures", "median_ms", "ms_of_99_percent", "product_median_ms"),
        *("product_ms_of_99_percent", "times_faster", "exact_percent"),
    )
    return Study(title, header, rows, panels)


def _postures(people: int, progress: Progress) -> Postures:
    spool = Spool(np.float32)
    for _, positions in scripted_postures(KINECT_V1, progress, people=people):
        spool.add(positions)
    order = np.random.default_rng(0).permutation(len(spool))[: _SIZES[-1]]
    return np.asarray(spool.array()[order])


def _queries(first: int) -> list[_Query]:
    queries: list[_Query] = []
    for k, motion in enumerate(_MOTIONS):
        draft = standardized(simulate("basic", motion, sensor="v1", seed=first + k))
        queries += list(zip(draft.standard, draft.reliability, strict=True))[::_EVERY]
    return queries


def _product_search(postures: Postures) -> Callable[[_Query], NDArray[np.intp]]:
    squares = np.sum(postures**2, axis=2)
    flat = postures.reshape(len(postures), -1)
    products = np.concatenate([squares, -2.0 * flat], axis=1)

    def search(query: _Query) -> NDArray[np.intp]:
        posture, reliability = query
        seen = np.where(reliability[:, None] > 0.0, posture, 0.0)
        weights = np.concatenate([reliability, (reliability[:, None] * seen).ravel()])
        distances = products @ weights.astype(np.float32)
        return np.argpartition(distances, _NEIGHBORS - 1)[:_NEIGHBORS]

    return search


def _milliseconds(
    find: Callable[[_Query], object], queries: Sequence[_Query]
) -> list[float]:
    times = np.empty((_REPEATS, len(queries)))
    for repeat in range(_REPEATS):
        for k, query in enumerate(queries):
            start = perf_counter()
            find(query)
            times[repeat, k] = perf_counter() - start
    return [float(ms) for ms in np.percentile(times.min(axis=0) * 1e3, [50, 99])]


def _exact(index: PostureIndex, postures: Postures, queries: Sequence[_Query]) -> float:
    exact = []
    for posture, reliability in queries[::_CHECKED]:
        distances = np.zeros(len(postures))
        for j in np.flatnonzero(reliability):
            offsets = postures[:, j] - posture[j]
            distances += reliability[j] * np.vecdot(offsets, offsets)
        expected = np.sort(np.partition(distances, _NEIGHBORS)[:_NEIGHBORS])
        found = index.nearest(posture, reliability, _NEIGHBORS)[1]
        exact.append(np.allclose(found, expected, rtol=1e-12, atol=1e-12))
    return 100.0 * float(np.mean(exact))
