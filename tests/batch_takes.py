"""Folders of takes for batches, cut out of simulated ones, and who cleans them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters import Take
from kinefilter.pipeline.batch.manifest import Row
from kinefilter.pipeline.batch.plan import Job
from kinefilter.pipeline.batch.task import clean_file
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.scenes.sensor import sample_take

__all__ = ["Here", "make_takes", "second_view", "short_take", "write_session"]

_MOTIONS = ("walk", "squat", "punch", "tai_chi", "wave")
_TREMBLE = 0.002  # m: takes differ, and stay as hard to clean


class Here:
    """A crew that does jobs in the test's own process, which is quick to begin."""

    room = 2

    def __init__(self, *_: object) -> None:
        self.jobs: list[Job] = []

    def is_idle(self) -> bool:
        return False

    def end(self) -> None:
        pass

    def submit(self, job: Job) -> None:
        self.jobs.append(job)

    def finished(self) -> list[tuple[Job, Row | None]]:
        job = self.jobs.pop()
        return [(job, clean_file(job))]


def short_take(frames: int, start: int = 0, seed: int = 0) -> Take:
    """Return a part of the sample that comes with kinefilter."""
    return _trembling(_part(_sample(), start, frames), seed)


def second_view(take: Take, degrees: float = 60.0, seed: int = 0) -> Take:
    """Return a take as a second sensor has it, which goes round the person by a turn.

    Its clock is 33,657.5 s ahead.
    """
    middle, turn = [0.0, 0.0, 2.5], Rotation.from_euler("y", degrees, degrees=True)
    turned = (take.positions - middle) @ turn.as_matrix().T + middle
    again = replace(take, time=take.time + 33657.5, positions=turned)
    return _trembling(again, 1000 + seed)


def write_session(
    folder: Path, name: str, take: Take, degrees: float = 60.0
) -> tuple[Path, Path]:
    """Write a take and its second view as ``NAME_A.csv`` and ``NAME_B.csv``."""
    paths = folder / f"{name}_A.csv", folder / f"{name}_B.csv"
    for path, one in zip(paths, (take, second_view(take, degrees)), strict=True):
        write_take_csv(one, path)
    return paths


@cache
def _sample() -> Take:
    return sample_take()


def make_takes(
    folder: Path, count: int, frames: int, *, sessions: bool = False
) -> None:
    """Write takes of Kinect v1 and v2 into folders of a folder.

    With ``sessions`` two of five are by two sensors, none of them a walk, which leaves
    the view.
    """
    sources = [
        simulate("basic", motion, sensor=sensor, seed=seed).take
        for seed, motion in enumerate(_MOTIONS)
        for sensor in ("v1", "v2")
    ]
    long = [take for take in sources if len(take) > frames // 2]
    for k in range(count):
        take = _repeated(long[k % len(long)], frames)
        path = folder / f"day_{k % 7}" / f"take_{k:04d}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        if sessions and k % 5 > 2:
            write_session(path.parent, path.stem, _trembling(take, k))
        else:
            write_take_csv(_trembling(take, k), path)


def _repeated(take: Take, frames: int) -> Take:
    """Return a take of so many frames: forth, back, forth, as long as it takes."""
    count = len(take)
    there = np.arange(frames) % (2 * count - 2)
    index = np.where(there < count, there, 2 * count - 2 - there)
    step = float(np.median(np.diff(take.time)))
    return replace(
        take,
        time=np.arange(frames) * step,
        positions=take.positions[index],
        state=take.state[index],
    )


def _part(take: Take, start: int, frames: int) -> Take:
    kept = slice(start, start + frames)
    return replace(
        take,
        time=take.time[kept],
        positions=take.positions[kept],
        state=take.state[kept],
    )


def _trembling(take: Take, seed: int) -> Take:
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, _TREMBLE, take.positions.shape)
    return replace(take, positions=take.positions + noise)
