"""The ridge behind the learned corrector: weights, all random effects marginalized."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, cho_factor, cho_solve, cholesky, solve_triangular

from kinefilter.characters.arrays import Array

from .random_features import Floats, RandomFeatures

_SHARE = 0.1  # a: variance of an effect, against 1 of what all people share
_SIMULATED_SHARE = 0.05  # of the effect that simulated people have in common
_BATCH = 2048  # rows whose products are summed at a time


@dataclass(frozen=True, eq=False)
class Person:
    """Frames of one person, or of their mirror image."""

    features: Floats
    offsets: Array
    clips: NDArray[np.intp]
    noise: float


def ridge_weights(
    random: RandomFeatures,
    columns: NDArray[np.intp],
    recorded: list[Person],
    simulated: list[Person],
    mean: Floats,
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


def _add(
    information: Floats,
    wanted: Array,
    random: RandomFeatures,
    columns: NDArray[np.intp],
    people: list[Person],
    mean: Floats,
    steps: Iterator[int],
) -> None:
    """Add what people tell about the weights, and about a constant, in place."""
    waiting: list[Floats] = []
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
    mean: Floats,
) -> tuple[Floats, Floats]:
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


def _symmetric(upper: Floats) -> Floats:
    return np.asarray(upper + np.triu(upper, 1).T)
