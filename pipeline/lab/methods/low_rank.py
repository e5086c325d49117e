"""Low-rank and sparse recovery of a whole take, as a baseline.

Wang, Li, Wu, Lai & Yang, "3-D motion recovery via low rank matrix analysis": the joint
positions of a take are a low-rank matrix plus a sparse error. Bone lengths change.
"""

from dataclasses import KW_ONLY, dataclass

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation

from .filters import WholeTake, bridge_gaps

_FIRST_STIFFNESS = 1.25  # mu times the largest singular value, as in Lin et al. 2010
_TOLERANCE = 1e-7  # norm of D - A - E relative to that of D


@dataclass(frozen=True, eq=False)
class Decomposition:
    """A decomposition D = A + E."""

    low_rank: Array  # A, shape (M, N)
    sparse: Array  # E, shape (M, N)
    multiplier: Array  # Y, the Lagrange multiplier of D = A + E, shape (M, N)
    iterations: int  # number of iterations
    converged: bool  # true if D - A - E is within the tolerance


def threshold_singular_values(matrix: Array, threshold: float) -> Array:
    """Return a tall matrix with lower singular values, down to 0 (M of eq. 6)."""
    squares, right = np.linalg.eigh(matrix.T @ matrix)
    values = np.sqrt(np.maximum(squares, 0.0))
    kept = values > threshold
    share, right = 1.0 - threshold / values[kept], right[:, kept]
    return np.asarray(matrix @ ((right * share) @ right.T))


def decompose(
    matrix: Array, penalty: Array, growth: float = 1.05, iterations: int = 1000
) -> Decomposition:
    """Minimize nuclear(A) + sum of penalty |E| with A + E = D (eq. 3).

    The inexact augmented Lagrangian of algorithm 1, with the multiplier starting at 0.

    D is finite, (M, N), tall; the penalty of each entry's error, (M, N), is lambda, or
    0 where nothing was measured. ``growth`` is rho, by which mu grows; the common 1.5
    stops short of the minimum.
    """
    size = float(np.linalg.norm(matrix))
    error, dual = np.zeros_like(matrix), np.zeros_like(matrix)
    if size == 0.0:
        return Decomposition(error, error, dual, 0, True)
    stiffness = _FIRST_STIFFNESS / float(np.linalg.norm(matrix.T @ matrix, 2)) ** 0.5
    for iteration in range(1, iterations + 1):
        # Eq. 5 and 6 are printed with A and E swapped; algorithm 1 is right.
        rest = matrix + dual / stiffness
        clean = threshold_singular_values(rest - error, 1.0 / stiffness)
        rest -= clean
        bound = penalty / stiffness
        held = np.clip(rest, -bound, bound)
        np.subtract(rest, held, out=error)  # the shrinkage S of eq. 5
        # The part within the bound is Y / mu + D - A - E, the new multiplier over mu.
        held *= stiffness
        left = float(np.linalg.norm(held - dual)) / stiffness
        dual = held
        if left <= _TOLERANCE * size:
            return Decomposition(clean, error, dual, iteration, True)
        stiffness *= growth
    return Decomposition(clean, error, dual, iterations, False)


@dataclass
class LowRank(WholeTake):
    """Removes sparse errors from a take.

    Errors within gaps cost nothing, so the measured joints determine the positions
    there. A joint that was never measured stays NaN. ``iterations_`` and ``converged_``
    tell how many the last take needed, and whether they were enough.
    """

    _: KW_ONLY
    sparsity: float = 2.0
    """C, the price of errors: lambda = C / sqrt(max(3 T, J)). The usual 1 removes some
    of the motion, which is not quite low-rank."""
    growth: float = 1.05  # rho, as in ``decompose``; 1 or more
    iterations: int = 1000  # maximum number of iterations

    def __post_init__(self) -> None:
        if self.growth < 1.0:
            raise InputError(f"growth={self.growth:g}: mu has to grow; give 1 or more")

    def _filtered(self, take: Observation) -> Array:
        seen = ~np.isnan(take.positions[..., 0])
        joints = np.flatnonzero(seen.any(axis=0))
        rows = bridge_gaps(take.time, take.positions)[:, joints].transpose(0, 2, 1)
        matrix = rows.reshape(3 * len(seen), len(joints))
        del rows  # so that an hour's take fits in a gigabyte
        price = self.sparsity / np.sqrt(max(len(matrix), seen.shape[1]))
        penalty = price * np.repeat(seen[:, joints], 3, axis=0)
        result = decompose(matrix, penalty, self.growth, self.iterations)
        self.iterations_, self.converged_ = result.iterations, result.converged
        recovered = np.full_like(take.positions, np.nan)
        clean = result.low_rank.reshape(len(seen), 3, len(joints))
        recovered[:, joints] = clean.transpose(0, 2, 1)
        return recovered
