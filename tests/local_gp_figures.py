"""Print what is claimed of the local Gaussian processes, from recorded pairs.

    python tests/local_gp_figures.py ../shared/data/ui-prmd/s*.npz

Learned from 2,500 frames of the repetitions e01 to e07, the same for every method, and
tested on 2,000 of e08 to e10, each frame by itself. Error: mean distance of the learned
joints from mocap, standard body, root-relative, as the processes see it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.correct.full_gp import FullGP, JointFeatures
from kinefilter.pipeline.correct.gaussian_process import grow_factor, grow_inverse
from kinefilter.pipeline.correct.lessons import Lessons
from kinefilter.pipeline.correct.local_gp import LocalGP
from kinefilter.pipeline.training import TrainingSet, read_pairs, training_set

Array = NDArray[np.float64]

SAMPLES, TESTED, TIMED = 2500, 2000, 200
print_line = Console(soft_wrap=True, highlight=False).print


def subset(training: TrainingSet, count: int, seed: int) -> TrainingSet:
    """Return some frames of a training set."""
    rows = np.random.default_rng(seed).permutation(len(training))[:count]
    assert training.lengths is not None
    return replace(
        training,
        positions=training.positions[rows],
        rate=training.rate[rows],
        truth=training.truth[rows],
        first=np.ones(len(rows), dtype=bool),
        lengths=training.lengths[rows],
    )


def mean_error(method: FullGP | LocalGP, test: TrainingSet) -> float:
    """Return the mean distance from mocap [cm]."""
    distances = []
    for seen, rate, truth in zip(test.positions, test.rate, test.truth, strict=True):
        method.start()
        moved = method.step(Observation(seen, rate, rate)).positions
        distances.append(np.linalg.norm((moved - truth)[method.joints_], axis=1))
    return float(np.nanmean(distances)) * 100


def milliseconds(work: Callable[[int], object], times: int) -> float:
    """Return the median time of ``work(k)``, k counting up [ms]."""
    taken = []
    for k in range(times):
        start = perf_counter()
        work(k)
        taken.append(perf_counter() - start)
    return float(np.median(taken)) * 1e3


def reference(full: FullGP, lessons: Lessons) -> list[GaussianProcessRegressor]:
    """Return scikit-learn's process of every joint, same kernels and samples."""
    features = JointFeatures(full.skeleton, full.joints_, full.seen_)
    rows = features(lessons.postures) * full.kernels_.roots
    found = []
    for m in range(len(full.joints_)):
        kernel = (
            ConstantKernel(full.kernels_.theta0[m]) * RBF(1.0)
            + ConstantKernel(full.kernels_.theta1[m])
            + WhiteKernel(full.kernels_.noise[m])
        )
        process = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
        found.append(process.fit(rows[:, m], lessons.offsets[:, m]))
    return found


def print_comparison(train: TrainingSet, test: TrainingSet) -> None:
    """Print error and time of local, full and scikit-learn's processes."""
    skeleton = train.skeleton
    full = FullGP(skeleton, samples=SAMPLES).fit(train)
    local = LocalGP(skeleton).fit(train).with_terms(temporal=0.0, reliability=0.0)
    processes = reference(full, Lessons.drawn(train, skeleton, SAMPLES, full.seed))
    features = JointFeatures(skeleton, full.joints_, full.seen_)
    whole = test.positions[~np.isnan(test.positions[:, full.seen_]).any(axis=(1, 2))]

    def with_sklearn(k: int) -> Array:
        x = features(np.nan_to_num(whole[k])) * full.kernels_.roots
        return np.array(
            [
                process.predict(x[m][None], return_std=True)[0][0]
                for m, process in enumerate(processes)
            ]
        )

    def with_full(k: int) -> Array:
        ones = np.ones(len(skeleton))
        full.start()
        moved = full.step(Observation(whole[k], ones, ones)).positions
        return np.asarray((moved - whole[k])[full.joints_])

    def with_local(k: int) -> object:
        ones = np.ones(len(skeleton))
        local.start()
        return local.step(Observation(whole[k], ones, ones))

    same = max(np.abs(with_sklearn(k) - with_full(k)).max() for k in range(20))
    errors = {"full-gp": mean_error(full, test), "local-gp": mean_error(local, test)}
    times = {
        "full-gp (mean only)": milliseconds(with_full, TIMED),
        "scikit-learn (mean and variance)": milliseconds(with_sklearn, 20),
        "local-gp (mean and variance)": milliseconds(with_local, TIMED),
    }
    print_line(f"{len(full.joints_)} joints, {len(full.postures_)} samples")
    print_line(f"  full-gp is scikit-learn's within {same * 1e3:.4f} mm")
    for name, error in errors.items():
        print_line(f"  {name:34s} {error:.3f} cm {error / errors['full-gp'] - 1:+.1%}")
    for name, time in times.items():
        ratio = time / times["local-gp (mean and variance)"]
        print_line(f"  {name:34s} {time:.3f} ms a frame, {ratio:.1f} times local-gp's")


def print_budgeting(train: TrainingSet, test: TrainingSet) -> None:
    """Print what posture budgeting drops, and what that costs."""
    print_line("posture budgeting, models as large as their clusters")
    whole, most = 0, 0.0
    for redundancy in (0.0, 0.02, 0.04, 0.1):
        method = LocalGP(train.skeleton, samples=400, redundancy=redundancy).fit(train)
        method = method.with_terms(temporal=0.0, reliability=0.0)
        kept, error = int(method.counts_.sum()), mean_error(method, test)
        if not whole:
            whole, most = kept, error
        print_line(
            f"  redundancy {redundancy:4.2f}: {kept} samples, "
            f"{1 - kept / whole:.0%} dropped, {error:.3f} cm {error / most - 1:+.1%}"
        )


def print_growth() -> None:
    """Print the time of an online update by the size of the model."""
    print_line("online update of one model")
    generator = np.random.default_rng(0)
    sizes, times = (25, 50, 100, 200, 400), []
    for size in sizes:
        square = generator.normal(size=(size, size))
        matrix = square @ square.T + size * np.eye(size)
        factor, inverse = np.linalg.cholesky(matrix).T, np.linalg.inv(matrix)
        row = generator.normal(size=size)

        def update(
            _: int, factor: Array = factor, inverse: Array = inverse, row: Array = row
        ) -> Array:
            grown = grow_factor(factor, row, 10.0 * len(row))
            return grow_inverse(inverse, grown)

        times.append(milliseconds(update, 200))
        print_line(f"  {size:4d} samples: {times[-1]:.3f} ms")
    slope = np.polyfit(np.log(sizes[2:]), np.log(times[2:]), 1)[0]
    print_line(f"  grows as S^{slope:.1f} from 100 to 400 samples")


if __name__ == "__main__":
    pairs = [pair for name in sys.argv[1:] for pair in read_pairs(Path(name))]
    late = [pair.clip.split("_")[2][:3] > "e07" for pair in pairs]
    learned = training_set(
        [p for p, is_late in zip(pairs, late, strict=True) if not is_late]
    )
    tested = training_set(
        [p for p, is_late in zip(pairs, late, strict=True) if is_late]
    )
    lessons, held_back = subset(learned, SAMPLES, 0), subset(tested, TESTED, 1)
    print_comparison(lessons, held_back)
    print_budgeting(lessons, held_back)
    print_growth()
