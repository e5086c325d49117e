"""Low-rank and sparse recovery of a whole take, as a baseline.

Wang, Li, Wu, Lai & Yang, 3-D Motion Recovery via Low Rank Matrix Analysis: the joints'
positions over a take are a matrix of low rank plus an error that is sparse. Bone
lengths are not kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation

from .filters import WholeTake, bridge_gaps

_FIRST_STIFFNESS = 1.25  # mu times the largest singular value, as in Lin et al. 2010
_TOLERANCE = 1e-7  # of what is left of D - A - E, against D


@dataclass(frozen=True, eq=False)
class Decomposition:
    """D = A + E, as it was found."""

    low_rank: Array
    """A, shape (M, N)."""
    sparse: Array
    """E, shape (M, N)."""
    multiplier: Array
    """Y, the Lagrange multiplier of D = A + E, shape (M, N)."""
    iterations: int
    """Iterations taken."""
    converged: bool
    """D - A - E is small enough."""


def threshold_singular_values(matrix: Array, threshold: float) -> Array:
    """Return the matrix with singular values lowered by a threshold, at least to 0.

    M of eq. 6, for tall matrices (M, N): it takes the N x N Gram matrix apart and never
    the matrix itself.
    """
    squares, right = np.linalg.eigh(matrix.T @ matrix)
    values = np.sqrt(np.maximum(squares, 0.0))
    kept = values > threshold
    share, right = 1.0 - threshold / values[kept], right[:, kept]
    return np.asarray(matrix @ ((right * share) @ right.T))


def decompose(
    matrix: Array, penalty: Array, *, growth: float = 1.05, iterations: int = 1000
) -> Decomposition:
    """Minimize nuclear(A) + sum of penalty |E| with A + E = D (eq. 3).

    The inexact augmented Lagrangian of algorithm 1, its multiplier starting at 0.

    Args:
        matrix: D, finite, shape (M, N), tall.
        penalty: Price of the error of each entry, lambda or, where nothing was
            observed, 0, shape (M, N).
        growth: rho, by which mu grows; the common 1.5 stops short of the minimum.
        iterations: Most iterations.
    """
    size = float(np.linalg.norm(matrix))
    error, dual = np.zeros_like(matrix), np.zeros_like(matrix)
    if size == 0.0:
        return Decomposition(error, error, dual, 0, True)
    stiffness = _FIRST_STIFFNESS / float(np.linalg.norm(matrix.T @ matrix, 2)) ** 0.5
    for iteration in range(1, iterations + 1):
        # Eq. 5 and 6 are printed with A and E swapped; algorithm 1 has them right.
        rest = matrix + dual / stiffness
        clean = threshold_singular_values(rest - error, 1.0 / stiffness)
        rest -= clean
        bound = penalty / stiffness
        held = np.clip(rest, -bound, bound)
        np.subtract(rest, held, out=error)  # the shrinkage S of eq. 5
        # What shrinkage holds back is Y / mu + D - A - E.
        held *= stiffness
        left = float(np.linalg.norm(held - dual)) / stiffness
        dual = held
        if left <= _TOLERANCE * size:
            return Decomposition(clean, error, dual, iteration, True)
        stiffness *= growth
    return Decomposition(clean, error, dual, iterations, False)


class LowRank(WholeTake):
    """Takes the sparse errors out of a take.

    A gap has errors for free, so the joints that were seen decide what is in it; a
    joint that was never seen stays NaN.

    Args:
        sparsity: C, price of errors: lambda = C / sqrt(max(3 T, J)). The usual 1 is
            for matrices of low rank; 20 joints' movement is not quite, and loses by it
            more than errors.
        growth: rho, as in ``decompose``, above 1.
        iterations: Most iterations.

    Attributes:
        iterations_: Iterations that the last take took.
        converged_: Whether they were enough.
    """

    iterations_: int
    converged_: bool

    def __init__(
        self,
        skeleton: Skeleton | None = None,  # noqa: ARG002 - any will do
        *,
        sparsity: float = 2.0,
        growth: float = 1.05,
        iterations: int = 1000,
    ) -> None:
        if growth < 1.0:
            raise InputError(f"growth={growth:g}: mu has to grow; give 1 or more")
        self.sparsity = sparsity
        self.growth = growth
        self.iterations = iterations

    def _moved(self, take: Observation) -> Array:
        seen = ~np.isnan(take.positions[..., 0])
        joints = np.flatnonzero(seen.any(axis=0))
        rows = bridge_gaps(take.time, take.positions)[:, joints].transpose(0, 2, 1)
        matrix = rows.reshape(3 * len(seen), len(joints))
        del rows  # an hour's take is to fit a gigabyte
        price = self.sparsity / np.sqrt(max(len(matrix), seen.shape[1]))
        penalty = price * np.repeat(seen[:, joints], 3, axis=0)
        result = decompose(
            matrix, penalty, growth=self.growth, iterations=self.iterations
        )
        self.iterations_, self.converged_ = result.iterations, result.converged
        recovered = np.full_like(take.positions, np.nan)
        clean = result.low_rank.reshape(len(seen), 3, len(joints))
        recovered[:, joints] = clean.transpose(0, 2, 1)
        return recovered
