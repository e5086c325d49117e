"""Rigid transforms between the frames of two recordings."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from kinefilter.characters.arrays import Array

SIGMA = 0.05  # m: residuals several times as large count little. A guess
_ROUNDS = 20


class Placement(NamedTuple):
    """A rigid transform from one frame to another."""

    turn: Rotation
    shift: Array  # of the origin [m], shape (3,)

    def rotate(self, vectors: Array) -> Array:
        """Return vectors rotated to the other frame, without the shift, (..., 3)."""
        flat = vectors.reshape(-1, 3).copy()  # scipy takes no read-only arrays
        return np.asarray(self.turn.apply(flat).reshape(vectors.shape))

    def apply(self, points: Array) -> Array:
        """Return points [m] in the other frame, shape (..., 3)."""
        return self.rotate(points) + self.shift


def placement(points: Array, onto: Array) -> Placement:
    """Return the transform that best lays points [m] onto others, both (..., 3).

    Least squares, reweighted for Cauchy-distributed residuals, so that outliers count
    little. Points that are NaN on either side are ignored; at least three have to be
    left that are not on one line.
    """
    seen, there = points.reshape(-1, 3), onto.reshape(-1, 3)
    known = ~np.isnan(seen + there).any(axis=1)
    seen, there = seen[known], there[known]
    weights = np.ones(len(seen))
    for _ in range(_ROUNDS):
        middles = [np.average(p, axis=0, weights=weights) for p in (seen, there)]
        turn, _ = Rotation.align_vectors(there - middles[1], seen - middles[0], weights)
        placed = turn.apply(seen - middles[0]) + middles[1]
        weights = 1.0 / (1.0 + np.sum((placed - there) ** 2, axis=1) / SIGMA**2)
    return Placement(turn, middles[1] - turn.apply(middles[0]))
