"""Learns which way people face from how they bend, for ``failures.sides``.

``python -m kinefilter.pipeline.lab.facing_lessons RECORDINGS... --views SESSIONS...
--walking TAKES... [--test RECORDINGS...]`` prints ``FACING_WEIGHTS``. Left and right
are compared with mocap (pairs files, and BVH, which a virtual Kinect sees), or with a
sensor that people face (sessions of two). In the takes people mostly walk forward,
which tells where the sensor swapped them. Then it prints for each person of ``--test``,
who must have no part in that, the share of frames [%] told right.
"""

import argparse
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.linear_model import LogisticRegression

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.failures.sides import (
    FACING_WEIGHTS,
    facing_inputs,
    root_velocity,
)
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.workers import workers

from .simulation import recorded_pairs
from .view_sessions import Session, find_sessions, placed, read_views, toward

_EVERY = 6  # clips of pairs
_CLEARLY = 0.05  # m by which joints are nearer to those of one side
_WALKS = 0.4  # m/s
_ALONG = 0.5  # cosine between the course and the heading


class Lesson(NamedTuple):
    """Frames of a person."""

    person: str
    inputs: Array  # as from ``facing_inputs``, (N, 8)
    right: Array  # 1.0 where left and right are, or -1.0, (N,)


def lessons_in(file: Path) -> list[Lesson]:
    """Return what people of a pairs file do, or of mocap before a virtual Kinect."""
    return [
        _compared(pair.subject, pair.take.positions, pair.truth, pair.take.skeleton)
        for pair in recorded_pairs(file, _EVERY)
    ]


def _before_another(session: Session) -> Lesson:
    """Return the frames of a session in which somebody faces the front sensor."""
    views, skeleton = read_views(session), read_take(session.first).skeleton
    some, person = toward(views), f"{session.person} {session.name.split('_')[-1]}"
    seen, truth = views.side.positions[views.frames][some], views.truth[some]
    return _compared(person, placed(seen, truth, skeleton), truth, skeleton)


def _compared(person: str, seen: Array, truth: Array, skeleton: Skeleton) -> Lesson:
    """Return the frames in which joints are clearly nearer to those of one side."""
    paired = np.flatnonzero(skeleton.mirror != np.arange(len(skeleton)))
    ours, theirs = (
        p - p[:, skeleton.hips].mean(axis=1, keepdims=True) for p in (seen, truth)
    )
    given, other = (
        np.linalg.norm(ours[:, paired] - theirs[:, joints], axis=2)
        for joints in (paired, skeleton.mirror[paired])
    )
    away = other - given
    nearer = np.nansum(away, axis=1) / np.maximum(np.isfinite(away).sum(axis=1), 1)
    known = np.abs(nearer) > _CLEARLY
    _, inputs = facing_inputs(seen[known], skeleton)
    return Lesson(person, inputs, np.sign(nearer[known]))


def _walk(file: Path) -> Lesson:
    """Return the frames of a take in which somebody walks, most likely forward."""
    take = read_take(file)
    take = take.at(np.flatnonzero(distinct_stamps(take.time)))
    forward, inputs = facing_inputs(take.positions, take.skeleton)
    velocity = root_velocity(take.time, take.positions[:, take.skeleton.root])
    velocity[:, 1] = 0.0
    speed = np.linalg.norm(velocity, axis=1)
    along = np.vecdot(velocity, np.nan_to_num(forward)) / np.maximum(speed, 1e-9)
    known = (speed > _WALKS) & (np.abs(along) > _ALONG)
    person = file.name.partition("_")[0] + " course"
    return Lesson(person, inputs[known], np.sign(along[known]))


def learn(lessons: list[Lesson]) -> Array:
    """Return the weights, by logistic regression; people count as the root of frames.

    Each frame also counts with left and right swapped.
    """
    counts = Counter[str]()
    for lesson in lessons:
        counts[lesson.person] += len(lesson.right)
    weights = np.concatenate(
        [np.full(len(one.right), counts[one.person] ** -0.5) for one in lessons]
    )
    inputs = np.concatenate([lesson.inputs for lesson in lessons])
    right = np.concatenate([lesson.right for lesson in lessons])
    scale = np.sqrt(np.average(inputs**2, axis=0, weights=weights))
    both = np.concatenate([inputs, -inputs]) / scale
    model = LogisticRegression(fit_intercept=False, max_iter=500)
    model.fit(both, np.concatenate([right, -right]) > 0.0, np.tile(weights, 2))
    return np.asarray(model.coef_[0] / scale)


def main() -> None:
    """Print the weights, and how often they are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+")
    for name in ("--views", "--walking", "--test"):
        parser.add_argument(name, type=Path, nargs="+", default=[])
    given = parser.parse_args()
    with workers() as pool:
        learned, tests = (
            list(chain.from_iterable(pool.map(lessons_in, sorted(files))))
            for files in (given.recordings, given.test)
        )
    learned += [_before_another(one) for one in find_sessions(given.views, None)]
    learned += [_walk(file) for file in sorted(given.walking)]
    weights = learn(learned).round(1)
    out.print(
        "FACING_WEIGHTS:",
        *weights,
        "" if (weights == FACING_WEIGHTS).all() else "(new)",
    )
    for person in sorted({lesson.person for lesson in tests}):
        told = [
            np.sign(one.inputs @ weights) == one.right
            for one in tests
            if one.person == person
        ]
        out.print(f"{person}: {100.0 * np.concatenate(told).mean():.1f} %")


if __name__ == "__main__":
    main()
