"""The ridge behind the learned corrector, and who it learns from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular

from kinefilter.characters.arrays import Array, Singles
from kinefilter.pipeline.correct import Hold
from kinefilter.pipeline.correct.posture_features import PostureFeatures
from kinefilter.pipeline.correct.random_features import RandomFeatures, direction_to

from .lessons import TrainingSet

_SHARE = 0.07  # a: variance of an effect, against 1 of what all people share
_SIMULATED_SHARE = 0.05  # of the effect that simulated people have in common
_OWN, _OWN_CLIP, _OWN_NOISE = 3.0, 0.03, 0.1  # variances where the person is known
_LEAST_NOISE = 0.1  # variance of the noise in a frame, against a signal of 1
_BATCH = 2048  # rows whose products are summed at a time


@dataclass(frozen=True, eq=False)
class Person:
    """Frames of one person, or of their mirror image."""

    features: Singles
    offsets: Array
    clips: NDArray[np.intp]
    noise: float


def people_of(training: TrainingSet, weight: float, most: int) -> Iterator[Person]:
    """Yield everybody who was recorded, each followed by their mirror image."""
    described = PostureFeatures(training.skeleton)
    clip = np.cumsum(training.first) - 1
    for person in np.unique(np.asarray(training.person)):
        rows = np.flatnonzero(training.person == person)
        bounds = np.flatnonzero(np.diff(clip[rows], prepend=-1, append=-1))
        takes = [_take(training, rows[a:b], described) for a, b in pairwise(bounds)]
        step = -(-sum(len(take.known) for take in takes) // most)
        # Where a clip begins to be counted varies.
        chosen = [take.known[k % step :: step] for k, take in enumerate(takes)]
        sizes = [len(some) for some in chosen]
        for mirrored in (False, True):
            features, offsets = [], []
            for take, some in zip(takes, chosen, strict=True):
                points, wanted, toward = take.points, take.offsets, take.toward
                if mirrored:
                    points, wanted = map(described.mirrored, (points, wanted))
                    toward = toward * [-1.0, 1.0]
                time = take.time
                features.append(
                    described(points[some], points, time[some], time, toward[some])
                )
                offsets.append(wanted[some].reshape(len(some), -1))
            yield Person(
                np.concatenate(features),
                np.concatenate(offsets),
                np.repeat(np.arange(len(sizes)), sizes),
                max(_LEAST_NOISE, sum(sizes) / weight),
            )


class _Take(NamedTuple):
    """The frames of a take to learn from, and the rows that have a truth."""

    points: Array
    offsets: Array
    toward: Array
    time: Array
    known: NDArray[np.intp]


def _take(
    training: TrainingSet, rows: NDArray[np.intp], described: PostureFeatures
) -> _Take:
    posture = Hold(training.skeleton).fill(training.positions[rows])
    wanted = (training.truth[rows] - posture)[:, described.joints]
    # The tracker's joints that mocap lost for a while: the clip's mean.
    known = ~np.isnan(wanted)
    mean = np.where(known, wanted, 0.0).sum(axis=0) / np.maximum(known.sum(0), 1)
    sensor = None if training.sensor is None else training.sensor[rows]
    time = np.arange(len(rows)) / 30.0
    if training.time is not None:
        time = training.time[rows]
    return _Take(
        described.points(posture),
        np.where(known, wanted, mean),
        direction_to(sensor, len(rows)),
        time,
        np.flatnonzero(known.any(axis=(1, 2))),
    )


def ridge_weights(
    random: RandomFeatures,
    columns: NDArray[np.intp],
    recorded: list[Person],
    simulated: list[Person],
    mean: Singles,
    steps: Iterator[int],
) -> Array:
    """Return the ridge's weights, all random effects marginalized."""
    size = random.size + 1
    information = np.zeros((size, size), dtype=np.float32, order="F")
    wanted = np.zeros((size, len(mean)))
    _add(information, wanted, random, columns, simulated, mean, steps)
    if simulated:
        # The effect that all of them share: (I + aG)^-1 G = (I - (I + aG)^-1) / a.
        total = _symmetric(information).astype(float) * _SIMULATED_SHARE
        total[np.diag_indices(size)] += 1.0
        factor = cho_factor(total, overwrite_a=True)
        wanted = cho_solve(factor, wanted)
        left = cho_solve(factor, np.eye(size), overwrite_b=True)
        left[np.diag_indices(size)] -= 1.0
        information = np.asfortranarray(left / -_SIMULATED_SHARE, dtype=np.float32)
    _add(information, wanted, random, columns, recorded, mean, steps)
    total = _symmetric(information).astype(float)[:-1, :-1]
    total[np.diag_indices(size - 1)] += 1.0
    return np.asarray(cho_solve(cho_factor(total, overwrite_a=True), wanted[:-1]))


def own_weights(
    random: RandomFeatures,
    columns: NDArray[np.intp],
    person: Person,
    weights: Array,
    mean: Singles,
) -> Array:
    """Return what one person alone has with postures, and a constant as the last row.

    Args:
        random: Makes the features.
        columns: Of the person's features that it takes.
        person: Whose they are.
        weights: What all people share.
        mean: Their mean offset [m].
    """
    rows = np.ones((len(person.features), random.size + 1), dtype=np.float32)
    rows[:, :-1] = random(person.features[:, columns])
    same = (person.clips[:, None] == person.clips).astype(float)
    covariance = _OWN * (rows @ rows.T).astype(float) + _OWN_CLIP * same
    covariance[np.diag_indices(len(rows))] += _OWN_NOISE
    left = person.offsets - mean - rows[:, :-1] @ weights
    factor = cho_factor(covariance, overwrite_a=True)
    return np.asarray(_OWN * rows.T @ cho_solve(factor, left))


def _add(
    information: Singles,
    wanted: Array,
    random: RandomFeatures,
    columns: NDArray[np.intp],
    people: list[Person],
    mean: Singles,
    steps: Iterator[int],
) -> None:
    """Add what people tell about the weights, and about a constant, in place."""
    waiting: list[Singles] = []
    for person in people:
        next(steps)
        rows, offsets = _independent(random, columns, person, mean)
        wanted += rows.T @ offsets
        waiting.append(rows)
        if person is people[-1] or sum(map(len, waiting)) > _BATCH:
            rows, waiting = np.concatenate(waiting), []
            blas.ssyrk(1.0, rows.T, beta=1.0, c=information, overwrite_c=1)


def _independent(
    random: RandomFeatures,
    columns: NDArray[np.intp],
    person: Person,
    mean: Singles,
) -> tuple[Singles, Singles]:
    """Return a person's features and offsets, without what correlates frames."""
    rows = np.ones((len(person.features), random.size + 1), dtype=np.float32)
    rows[:, :-1] = random(person.features[:, columns])
    same = (person.clips[:, None] == person.clips).astype(float)
    covariance = _SHARE * ((rows @ rows.T).astype(float) + same)
    covariance[np.diag_indices(len(rows))] += person.noise
    factor = cholesky(covariance, lower=True, overwrite_a=True).astype(np.float32)
    offsets = (person.offsets - mean).astype(np.float32)
    independent = solve_triangular(
        factor, np.hstack([rows, offsets]), lower=True, overwrite_b=True
    ).astype(np.float32, copy=False)
    return independent[:, : random.size + 1], independent[:, random.size + 1 :]


def _symmetric(upper: Singles) -> Singles:
    return np.asarray(upper + np.triu(upper, 1).T)
