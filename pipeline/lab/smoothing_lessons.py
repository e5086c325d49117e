"""Learns how live joints are smoothed, from takes and their zero-lag smoothing.

``python -m kinefilter.pipeline.lab.smoothing_lessons RECORDINGS... --test OTHERS...``
prints the weights for ``target.smooth_live``. It then prints, for the joints of the
others as smoothed by the shipped weights and by the One-Euro filter, their third
differences in per cent of those before, of all and of those at rest, and their
distances [cm] from their paths in whole takes, all and those faster than 0.8 m/s.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import distinct_stamps, values_at
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, Observation
from kinefilter.pipeline.live.crowd import MEASURED_FOR
from kinefilter.pipeline.target.smooth import (
    smooth_by_speed,
    travel_of,
    weights_of_outliers,
)
from kinefilter.pipeline.target.smooth_live import MOVING, STEP, LiveSmoother

from .evaluate import followed
from .methods.filters import OneEuro
from .recorded_acts import recordings_in

_SLOW, _FAST = 0.15, 0.8  # m/s: slower joints are at rest, faster ones teach nothing
_STEADY = {"at rest": 2.0, "moving": 0.3}  # weights of third differences
_EVERY = 9  # use every ninth clip of pairs


class Example(NamedTuple):
    """Joints of a take as they come to be smoothed live, and as smoothed in whole."""

    take: Take
    joints: Array  # [m], (T, J, 3)
    smooth: Array
    speed: Array  # [m/s], (T, J)


def example_of(take: Take) -> Example:
    """Return the joints of a take, with the person measured in the first second."""
    take = take.at(distinct_stamps(take.time))
    first = take.at(take.time <= take.time[0] + MEASURED_FOR)
    joints = followed(Cleaner().until("level"), take, first)
    weights = weights_of_outliers(take.time, joints)
    travel = travel_of(take.time, joints, take.skeleton)
    cutoff = CleanConfig().cutoff
    smooth = smooth_by_speed(take.time, joints, weights, cutoff=cutoff, travel=travel)
    speed = np.linalg.norm(np.gradient(smooth, take.time, axis=0), axis=2)
    return Example(take, joints, smooth, speed)


def fit(examples: Sequence[Example]) -> dict[str, list[float]]:
    """Return the weights of where joints were, at rest and moving."""
    count = len(MOVING)
    grams = {name: np.zeros((count, count)) for name in _STEADY}
    sides = {name: np.zeros(count) for name in _STEADY}
    for take, joints, smooth, speed in examples:
        before = take.time[:, None] - STEP * np.arange(1, count + 1)
        past = values_at(take.time, joints, before) - joints[:, None]
        past, away = np.moveaxis(past, 1, -1), smooth - joints
        turns, leaps = np.diff(past, 3, axis=0), -np.diff(joints, 3, axis=0)
        for name, steady in _STEADY.items():
            slow = speed < _SLOW
            some = slow if name == "at rest" else ~slow & (speed < _FAST)
            for rows, wanted, weight in (
                (past[some], away[some], 1.0),
                (turns[some[3:]], leaps[some[3:]], steady),
            ):
                columns = rows.reshape(-1, count)
                grams[name] += weight * columns.T @ columns
                sides[name] += weight * columns.T @ wanted.ravel()
    # Moving joints have no lag: the mean time of their weights is now.
    late = np.arange(1.0, count + 1.0)[:, None] * np.trace(grams["moving"])
    bordered = np.block([[grams["moving"], late], [late.T, np.zeros((1, 1))]])
    moving = np.linalg.solve(bordered, np.append(sides["moving"], 0.0))[:-1]
    rest = np.linalg.solve(grams["at rest"], sides["at rest"])
    return {"at rest": rest.round(4).tolist(), "moving": moving.round(4).tolist()}


def smoothed_by(smoother: LiveSmoother | Corrector, example: Example) -> Array:
    """Return the joints [m] (T, J, 3) of an example, smoothed frame by frame."""
    smoother.start()
    frames = zip(example.joints, example.take.time.tolist(), strict=True)
    if isinstance(smoother, LiveSmoother):
        return np.array([smoother.step(*frame) for frame in frames])
    sure = np.ones(example.joints.shape[1])
    seen = (Observation(joints, sure, sure, time) for joints, time in frames)
    return np.array([smoother.step(frame).positions for frame in seen])


def measures(found: Array, example: Example) -> list[float]:
    """Return the figures that the module tells of a smoothed example."""
    leaps, raw = (
        np.linalg.norm(np.diff(joints, 3, axis=0), axis=2)
        for joints in (found, example.joints)
    )
    away = np.linalg.norm(found - example.smooth, axis=2) * 100.0
    rest, fast = example.speed[3:] < _SLOW, example.speed > _FAST
    shares = [leaps[some].sum() / raw[some].sum() for some in (raw >= 0.0, rest)]
    far = [away[some].sum() / max(some.sum(), 1) for some in (away >= 0.0, fast)]
    return [share * 100.0 for share in shares] + far


def _examples(files: Iterable[Path]) -> list[Example]:
    takes = (
        named.take
        for file in files
        for named in list(recordings_in(file))[
            :: _EVERY if file.suffix == ".npz" else 1
        ]
    )
    return [example_of(take) for take in takes]


def main() -> None:
    """Print the weights, and what they do for the recordings of the test."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--test", nargs="*", type=Path, default=[])
    options = parser.parse_args()
    for name, weights in fit(_examples(options.recordings)).items():
        print(f"{name}: {weights}")
    tests = _examples(options.test)
    for name in ("weights", "One-Euro"):
        rows = []
        for example in tests:
            skeleton = example.take.skeleton
            euro = OneEuro(skeleton, min_cutoff=1.0, beta=12.0)
            smoother = euro if name == "One-Euro" else LiveSmoother(skeleton)
            rows.append(measures(smoothed_by(smoother, example), example))
        if rows:
            print(name, np.mean(rows, axis=0).round(2).tolist())


if __name__ == "__main__":
    main()
