"""How far heads look past the truth, with the face seen by an Azure Kinect and without.

Prints a table for simulated takes, and one for each size of the face's error. That
error is a guess, as no recording with ground truth is known: a constant one per person,
one that wanders within a second, and noise; no face is seen from the side or behind.

    python tests/face_figures.py [--seed 9100] [--performances 12]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter import Cleaner
from kinefilter.characters import KINECT_V2, Motion, Take
from kinefilter.characters.rotations import about_x, about_y, multiply, rotate
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes.library import perform, random_body
from kinefilter.scenes.sensor import SENSORS, in_sensor_frame, observe

_MOTIONS = (
    *("talk", "swing", "point", "walk", "tai_chi", "punch"),
    *("sit", "dance", "scratch", "golf_swing", "squat", "turn"),
)
_CONSTANT, _WANDERING, _NOISE = np.radians((5.0, 8.0, 4.0))
_SECONDS = 1.0  # over which the error wanders
_SEEN = np.cos(np.radians(80.0))  # from the direction to the sensor
_SIZES = (0.5, 1.0, 2.0, 3.0)
_HEAD = KINECT_V2.index("Head")

Array = NDArray[np.float64]


def looks(motion: Motion) -> Array:
    """Return where the head of a motion looks, sensor frame, (T, 3)."""
    sensor, ahead = SENSORS["azure"], rotate(motion.rotations[:, _HEAD], [0, 0, 1.0])
    start = motion.positions[:, _HEAD]
    return in_sensor_frame(start + ahead, sensor) - in_sensor_frame(start, sensor)


def with_face(take: Take, true: Array, size: float, seed: int) -> Take:
    """Return a take with a face whose error has a size relative to the guess."""
    rng, count = np.random.default_rng([seed, 77]), len(take)
    share = np.exp(-1.0 / (_SECONDS * take.fps))
    slow = rng.normal(0.0, 1.0, (count, 2))
    for k in range(1, count):
        slow[k] = share * slow[k - 1] + np.sqrt(1.0 - share**2) * slow[k]
    error = _CONSTANT * rng.normal(size=2) + _WANDERING * slow
    error = size * (error + _NOISE * rng.normal(size=(count, 2)))
    face = rotate(multiply(about_y(error[:, 0]), about_x(error[:, 1])), true)
    to_sensor = -take.positions[:, _HEAD]
    to_sensor /= np.linalg.norm(to_sensor, axis=1, keepdims=True)
    face[~(np.vecdot(true, to_sensor) > _SEEN)] = np.nan
    return replace(take, face=face)


def errors(cleaner: Cleaner, take: Take, true: Array) -> tuple[float, float]:
    """Return how far the head of a clean take looks past the truth [degrees].

    The second figure is that of a head that looks where the chest does.
    """
    clip = cleaner.clean(take).clip
    true = leveled(true, clip.tilt, clip.roll)
    parts = clip.rotations[:, [_HEAD, KINECT_V2.girdle]]
    found = rotate(parts, [0.0, 0.0, 1.0])
    cosine = np.clip(np.vecdot(found, true[:, None]), -1.0, 1.0)
    head, chest = np.degrees(np.arccos(cosine)).mean(axis=0)
    return float(head), float(chest)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=9100)
    parser.add_argument("--performances", type=int, default=12)
    chosen = parser.parse_args()
    cleaner, rows = Cleaner(), []
    out.print(
        "motion, head without face, as chest, with face and error of size", *_SIZES
    )
    for k in range(chosen.performances):
        seed, name = chosen.seed + k, _MOTIONS[k % len(_MOTIONS)]
        body = random_body(KINECT_V2, np.random.default_rng(seed))
        motion = perform(name, body, seed=seed, fps=30.0)
        take = observe(motion, seed=seed, sensor=SENSORS["azure"])
        since = take.time - take.time[0]
        true = looks(motion)[np.abs(motion.time[:, None] - since).argmin(axis=0)]
        row = [*errors(cleaner, take, true)]
        for size in _SIZES:
            row.append(errors(cleaner, with_face(take, true, size, seed), true)[0])
        rows.append(row)
        out.print(f"{name:12s}", *(f"{value:5.1f}" for value in row))
    out.print(f"{'mean':12s}", *(f"{value:5.1f}" for value in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
