"""Ridge regression for the learned corrector, and the people it is trained on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular

from kinefilter.characters.arrays import Array, Indices, Singles
from kinefilter.pipeline.correct import Hold
from kinefilter.pipeline.correct.posture_features import PostureFeatures
from kinefilter.pipeline.correct.random_features import RandomFeatures, direction_to

from .training_data import TrainingSet

# Variances of random effects and noise, relative to 1 for what all people share.
_SHARE = 0.07  # a: of the effect of a person or a clip
_SIMULATED_SHARE = 0.05  # of the effect that all simulated people have in common
_OWN, _OWN_CLIP, _OWN_NOISE = 3.0, 0.03, 0.1  # for a known person's own weights
_LEAST_NOISE = 0.1  # of the noise in a frame
_BATCH = 2048  # rows whose products are summed at a time


@dataclass(frozen=True, eq=False)
class Person:
    """Training frames of one person, or their mirror images."""

    features: Singles
    """Features of the postures, shape (N, F)."""
    offsets: Array
    """Offsets of the known joints [m], flattened, shape (N, 3 M)."""
    clips: Indices
    """Index of the clip of each frame, shape (N,)."""
    noise: float
    """Variance of the noise in a frame."""


def people_in(training: TrainingSet, weight: float, most: int) -> Iterator[Person]:
    """Yield all recorded people, each followed by their mirror image.

    Args:
        training: The frames of all people.
        weight: Total weight of a person's frames: the variance of the noise in a frame
            is the number of frames over this.
        most: Maximum number of frames per person.
    """
    features = PostureFeatures(training.skeleton)
    clip = np.cumsum(training.first) - 1
    for person in np.unique(np.asarray(training.person)):
        rows = np.flatnonzero(training.person == person)
        bounds = np.flatnonzero(np.diff(clip[rows], prepend=-1, append=-1))
        takes = [_take(training, rows[a:b], features) for a, b in pairwise(bounds)]
        step = -(-sum(len(take.known) for take in takes) // most)
        # Start at a different frame in each clip.
        chosen = [take.known[k % step :: step] for k, take in enumerate(takes)]
        sizes = [len(frames) for frames in chosen]
        for mirrored in (False, True):
            inputs, outputs = [], []
            for take, frames in zip(takes, chosen, strict=True):
                points, offsets, toward = take.points, take.offsets, take.toward
                if mirrored:
                    points, offsets = map(features.mirrored, (points, offsets))
                    toward = toward * [-1.0, 1.0]
                now = take.time[frames]
                inputs.append(
                    features(points[frames], points, now, take.time, toward[frames])
                )
                outputs.append(offsets[frames].reshape(len(frames), -1))
            yield Person(
                np.concatenate(inputs),
                np.concatenate(outputs),
                np.repeat(np.arange(len(sizes)), sizes),
                max(_LEAST_NOISE, sum(sizes) / weight),
            )


class _Take(NamedTuple):
    points: Array
    offsets: Array
    toward: Array
    time: Array
    known: Indices
    """The frames that have ground truth."""


def _take(training: TrainingSet, rows: Indices, features: PostureFeatures) -> _Take:
    posture = Hold(training.skeleton).fill(training.positions[rows])
    offsets = (training.truth[rows] - posture)[:, features.joints]
    # A joint that mocap lost for a while gets its mean offset in the clip.
    known = ~np.isnan(offsets)
    mean = np.where(known, offsets, 0.0).sum(axis=0) / np.maximum(known.sum(0), 1)
    sensor = None if training.sensor is None else training.sensor[rows]
    time = training.time
    return _Take(
        features.points(posture),
        np.where(known, offsets, mean),
        direction_to(sensor, len(rows)),
        np.arange(len(rows)) / 30.0 if time is None else time[rows],
        np.flatnonzero(known.any(axis=(1, 2))),
    )


def ridge_weights(
    random: RandomFeatures,
    recorded: list[Person],
    simulated: list[Person],
    steps: Iterator[int],
) -> Array:
    """Return the weights that all people share, with random effects marginalized.

    Args:
        random: The random features.
        recorded: Recorded people, whose mean offset has been subtracted.
        simulated: Simulated people, likewise.
        steps: Advanced once per person, for a progress bar.
    """
    size = random.size + 1
    information = np.zeros((size, size), dtype=np.float32, order="F")
    products = np.zeros((size, recorded[0].offsets.shape[1]))
    _add(information, products, random, simulated, steps)
    if simulated:
        # The effect that all of them share: (I + aG)^-1 G = (I - (I + aG)^-1) / a.
        total = _symmetric(information).astype(float) * _SIMULATED_SHARE
        total[np.diag_indices(size)] += 1.0
        factor = cho_factor(total, overwrite_a=True)
        products = cho_solve(factor, products)
        inverse = cho_solve(factor, np.eye(size), overwrite_b=True)
        inverse[np.diag_indices(size)] -= 1.0
        information = np.asfortranarray(inverse / -_SIMULATED_SHARE, dtype=np.float32)
    _add(information, products, random, recorded, steps)
    total = _symmetric(information).astype(float)[:-1, :-1]
    total[np.diag_indices(size - 1)] += 1.0
    return np.asarray(cho_solve(cho_factor(total, overwrite_a=True), products[:-1]))


def own_weights(random: RandomFeatures, person: Person, shared: Array) -> Array:
    """Return a person's own weights on top of the shared ones, a constant last."""
    rows, products, same_clip = _design(random, person)
    covariance = _OWN * products + _OWN_CLIP * same_clip
    covariance[np.diag_indices(len(rows))] += _OWN_NOISE
    residuals = person.offsets - rows[:, :-1] @ shared
    factor = cho_factor(covariance, overwrite_a=True)
    return np.asarray(_OWN * rows.T @ cho_solve(factor, residuals))


def _add(
    information: Singles,
    products: Array,
    random: RandomFeatures,
    people: list[Person],
    steps: Iterator[int],
) -> None:
    """Add people's normal equations, for weights and a constant, in place."""
    waiting: list[Singles] = []
    for person in people:
        next(steps)
        rows, offsets = _whitened(random, person)
        products += rows.T @ offsets
        waiting.append(rows)
        if person is people[-1] or sum(map(len, waiting)) > _BATCH:
            rows, waiting = np.concatenate(waiting), []
            blas.ssyrk(1.0, rows.T, beta=1.0, c=information, overwrite_c=1)


def _whitened(random: RandomFeatures, person: Person) -> tuple[Singles, Singles]:
    """Return a person's features and offsets, whitened by the frames' covariance."""
    rows, products, same_clip = _design(random, person)
    covariance = _SHARE * (products + same_clip)
    covariance[np.diag_indices(len(rows))] += person.noise
    factor = cholesky(covariance, lower=True, overwrite_a=True).astype(np.float32)
    both = np.hstack([rows, person.offsets.astype(np.float32)])
    solved = solve_triangular(factor, both, lower=True, overwrite_b=True)
    white = solved.astype(np.float32, copy=False)
    return white[:, : random.size + 1], white[:, random.size + 1 :]


def _design(random: RandomFeatures, person: Person) -> tuple[Singles, Array, Array]:
    """Return random features with a constant, their products, and 1 per equal clip."""
    rows = np.ones((len(person.features), random.size + 1), dtype=np.float32)
    rows[:, :-1] = random(person.features)
    same_clip = (person.clips[:, None] == person.clips).astype(float)
    return rows, (rows @ rows.T).astype(float), same_clip


def _symmetric(upper: Singles) -> Singles:
    return np.asarray(upper + np.triu(upper, 1).T)
