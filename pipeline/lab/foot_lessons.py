"""Learns how steeply feet point from how legs move, in recordings with mocap.

``python -m kinefilter.pipeline.lab.foot_lessons OUT.npz RECORDINGS...`` writes the
weights of ``target.foot_pitch``; recordings are pairs files, and mocap in BVH, which a
virtual Kinect sees. It then prints how far feet are off [degrees] for each person, with
weights learned from the others: always flat, as Kinect shows them, and as predicted.
"""

import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array, Flags, Singles
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.correct.posture_features import RandomFeatures
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.foot_pitch import (
    FootPitch,
    described,
    legs_of,
    pitch_of,
)
from kinefilter.pipeline.workers import workers

from .methods.fourier_ridge_learner import centers_of
from .simulation import recorded_pairs

_EVERY = 4  # use every fourth clip of pairs
_STILL = 0.15  # m/s: feet with slower ankles are flat, in the median
# Chosen on s02, s03 and s04 and on CMU's people 02, 06, 07, 10, 16, 29 and 32.
_FEATURES, _RIDGE, _NARROWNESS = 512, 1.0, 1.0
_CENTERS = 256


class Lesson(NamedTuple):
    """Feet of a person in N frames, left and right."""

    person: str
    inputs: Singles  # of the prediction, shape (N, 2, F)
    pitch: Array  # in mocap [rad], (N, 2)
    shown: Array  # by Kinect [rad], (N, 2)
    still: Flags  # whether the ankle rests, (N, 2)


def read_lessons(files: Sequence[Path]) -> list[Lesson]:
    """Return what each person does in recordings."""
    with workers() as pool:
        found = list(chain.from_iterable(pool.map(_lessons_in, files)))
    lessons = []
    for person in sorted({lesson.person for lesson in found}):
        rows = zip(*(one[1:] for one in found if one.person == person), strict=True)
        inputs, pitch, shown, still = map(np.concatenate, rows)
        # Where the markers of toes are on a person's feet is not known.
        flat = [np.median(pitch[still[:, k], k]) for k in range(2)]
        lessons.append(Lesson(person, inputs, pitch - flat, shown, still))
    return lessons


def _lessons_in(file: Path) -> list[Lesson]:
    return [_lesson(pair) for pair in recorded_pairs(file, _EVERY)]


def _lesson(pair: PairedTake) -> Lesson:
    truth = pair.truth
    draft, time = Cleaner().until("floor").whole(pair.take), pair.take.time
    ankles, toes = ankles_and_toes(draft.skeleton)
    known = np.isfinite(truth[:, [*ankles, *toes]]).all(axis=(1, 2))
    pitch, shown = (pitch_of(joints, draft.body) for joints in (truth, draft.positions))
    speed = np.linalg.norm(np.gradient(truth[:, ankles], time, axis=0), axis=2)
    legs = legs_of(draft.positions, draft.skeleton)
    inputs, still = described(time, legs, time), speed < _STILL
    return Lesson(pair.subject, inputs[known], pitch[known], shown[known], still[known])


def learn(lessons: Sequence[Lesson]) -> FootPitch:
    """Return the prediction that is learned from people."""
    inputs = np.concatenate([one.inputs for one in lessons])
    inputs = inputs.reshape(-1, inputs.shape[2])
    pitch = np.concatenate([one.pitch.ravel() for one in lessons])
    # The more frames there are of a person, the less each of them counts.
    sizes = np.array([one.pitch.size for one in lessons])
    weights = np.repeat(sizes**-0.5, sizes)
    mean = inputs.mean(axis=0)
    scale = np.sqrt(_NARROWNESS / len(mean)) / inputs.std(axis=0)
    inputs, zeros = (inputs - mean) * scale, np.zeros_like(mean)
    features = RandomFeatures(zeros, _FEATURES, 0, zeros + 1)(inputs).astype(float)
    weighted = features * (weights / weights.mean())[:, None]
    gram = weighted.T @ features + _RIDGE * np.eye(features.shape[1])
    found = np.linalg.solve(gram, weighted.T @ pitch)
    arrays = mean, scale, found, centers_of(inputs, _CENTERS)
    return FootPitch(*(array.astype(np.float32) for array in arrays))


def errors(predict: FootPitch, one: Lesson) -> list[float]:
    """Return how far feet are off [degrees]: always flat, as shown, and predicted."""
    pitch, familiar = predict(one.inputs)
    guesses = 0.0 * pitch, one.shown, one.shown + familiar * (pitch - one.shown)
    return [float(np.degrees(np.abs(guess - one.pitch).mean())) for guess in guesses]


def main(file: Path, recordings: Sequence[str]) -> None:
    """Learn from recordings, write the weights, and print ``errors`` of each person."""
    lessons = read_lessons([Path(recording) for recording in recordings])
    write_arrays(file, learn(lessons).arrays())
    out.print("person, frames, always flat, as shown, predicted")
    for one in lessons:
        predict = learn([other for other in lessons if other is not one])
        values = (f"{value:5.1f}" for value in errors(predict, one))
        out.print(f"{one.person:4s} {len(one.pitch):6d}", *values)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
