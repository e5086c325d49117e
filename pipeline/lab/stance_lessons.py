"""Learns when live feet are planted from how legs move, in recordings with mocap.

``python -m kinefilter.pipeline.lab.stance_lessons OUT.npz RECORDINGS... [--test
RECORDINGS...]`` writes the weights of ``target.stance_odds``; recordings are pairs
files, and mocap in BVH, which a virtual Kinect sees. Simulated people teach as well.
Then it prints for each person of ``--test``, who must have no part in that, the share
of feet [%] whose stance is wrong.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.neural_network import MLPClassifier

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, Singles
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.networks import Network, network_arrays
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.stance_odds import described, legs_of
from kinefilter.pipeline.workers import workers
from kinefilter.scenes.library import MOTIONS

from .simulation import recorded_pairs, simulate, truth_of

_EVERY = 4  # use every fourth clip of pairs
_SIMULATED, _FIRST = 102, 100  # simulated people: two for each motion; their seeds
_IMAGINED = 0.1  # weight of a simulated motion; a recorded person has 1
_SLOW, _LOW = 0.3, 0.05
"""Speed [m/s] and height [m] of planted feet in mocap. With 0.4 and 0.08, feet that are
lifted by a few centimeters count as planted in between."""
_LOWEST = 5.0  # percentile of heights that is the floor
# Chosen on s02, s03 and s04 and CMU's people 02, 05, 06, 07, 10, 16, 29 and 32; a
# single layer of 16 to 64 units, other penalties and noise change little.
_LAYERS, _PENALTY, _NOISE = (64, 32), 0.1, 0.1
_EPOCHS, _AVERAGED = 20, 8  # the weights of the last epochs are averaged
_DRAWN, _BATCH, _RATE = 60_000, 500, 0.002
_SPREAD_FLOOR = 1e-3  # added to the spread of inputs, to ignore constant ones


class Lesson(NamedTuple):
    """Feet of a person in N frames, left and right."""

    person: str
    inputs: Singles  # of the network, (N, 2, F)
    planted: Flags  # (N, 2)
    known: Flags  # whether the mocap has them, (N, 2)
    weight: float = 1.0


def planted(
    time: Array, truth: Array, skeleton: Skeleton, slow: float, low: float
) -> tuple[Flags, Flags]:
    """Return whether each foot is planted, and whether it is known, both (T, 2).

    A planted foot's ankle or toes are slower than a speed [m/s] and lower than a height
    [m]. ``truth`` has the joints of the mocap [m] with the y axis up.
    """
    parts = truth[:, ankles_and_toes(skeleton)]  # (T, ankle and toes, foot, 3)
    speed = np.linalg.norm(np.gradient(parts, time, axis=0), axis=3)
    floor = np.nanpercentile(parts[..., 1], _LOWEST, axis=0)
    rests = (speed < slow) & (parts[..., 1] < floor + low)
    return np.any(rests, axis=1), np.all(np.isfinite(speed), axis=1)


def lessons_in(file: Path, every: int = _EVERY) -> list[Lesson]:
    """Return what people of a pairs file do, or of mocap before a virtual Kinect.

    Only ``every`` so many pairs of a file are taken.
    """
    return [_lesson(pair) for pair in recorded_pairs(file, every)]


def _simulated(k: int) -> list[Lesson]:
    """Return what a simulated person does, before a virtual Kinect and as it is."""
    motion, skeleton = MOTIONS[k % len(MOTIONS)], ("kinect_v2", "kinect_v1")[k % 2]
    pair = simulate(
        "basic", motion, skeleton=skeleton, seed=_FIRST + k, stay_in_view=True
    )
    exact = replace(pair, take=truth_of(pair))
    return [
        _lesson(one)._replace(person=f"{kind} {motion}", weight=_IMAGINED)
        for kind, one in (("seen", pair), ("exact", exact))
    ]


def _lesson(pair: PairedTake) -> Lesson:
    take, joints = pair.take, legs_of(pair.take.skeleton)
    cleaner = Cleaner(CleanConfig(physics=False)).until("floor")
    cleaner.start(*cleaner.measure(take))
    frames = zip(take.positions, take.time, take.state, strict=True)
    legs = np.array([cleaner.step(*frame).positions[joints] for frame in frames])
    inputs = described(take.time, legs, take.time)
    truth = planted(take.time, pair.truth, take.skeleton, _SLOW, _LOW)
    return Lesson(pair.subject, inputs, *truth)


def learn(lessons: Sequence[Lesson]) -> Network:
    """Return the network of people, who count as the root of their frames."""
    counts = Counter[str]()
    for one in lessons:
        counts[one.person] += int(one.known.sum())
    inputs = np.concatenate([one.inputs[one.known] for one in lessons])
    truth = np.concatenate([one.planted[one.known] for one in lessons])
    weights = np.concatenate(
        [
            np.full(one.known.sum(), one.weight * counts[one.person] ** -0.5)
            for one in lessons
        ]
    )
    weights /= weights.sum()
    mean = np.average(inputs, axis=0, weights=weights)
    spread = np.sqrt(np.average((inputs - mean) ** 2, axis=0, weights=weights))
    spread += _SPREAD_FLOOR
    network = MLPClassifier(
        _LAYERS, alpha=_PENALTY, learning_rate_init=_RATE, random_state=0
    )
    rng, kept = np.random.default_rng(0), []
    for epoch in range(_EPOCHS):
        drawn = rng.choice(len(inputs), _DRAWN, p=weights)
        for batch in drawn.reshape(-1, _BATCH):
            noise = _NOISE * rng.standard_normal((_BATCH, len(mean)))
            given = (inputs[batch] - mean) / spread + noise
            network.partial_fit(given, truth[batch], classes=[False, True])
        if epoch >= _EPOCHS - _AVERAGED:
            arrays = (*network.coefs_, *network.intercepts_)
            kept.append([array.copy() for array in arrays])
    averaged = [np.mean(one, axis=0) for one in zip(*kept, strict=True)]
    count = len(_LAYERS) + 1
    averaged[0] /= spread[:, None]
    averaged = [array.astype(np.float32) for array in averaged]
    layers = zip(averaged[:count], averaged[count:], strict=True)
    return Network(mean, list(layers))


def main() -> None:
    """Learn from recordings, write the weights, and print errors of other people."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--test", type=Path, nargs="+", default=[])
    given = parser.parse_args()
    with workers() as pool:
        learned, tests = (
            list(chain.from_iterable(pool.map(lessons_in, sorted(files))))
            for files in (given.recordings, given.test)
        )
        learned += chain.from_iterable(pool.map(_simulated, range(_SIMULATED)))
    network = learn(learned)
    write_arrays(given.out, network_arrays({"live": network}))
    for person in sorted({lesson.person for lesson in tests}):
        wrong = [
            ((network(one.inputs)[..., 0] > 0.0) != one.planted)[one.known]
            for one in tests
            if one.person == person
        ]
        out.print(f"{person:4s} {100.0 * np.concatenate(wrong).mean():5.1f}")


if __name__ == "__main__":
    main()
