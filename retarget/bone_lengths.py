"""Move joints the least that gives every bone its length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body

__all__ = ["BoneLengths"]

Array = NDArray[np.float64]

_CHUNK = 2048  # frames at a time, to bound the memory
_MOST_STEPS = 12
_EXACT = 1e-7  # m
_FIRMNESS_OF_INVENTED = (
    0.02  # against a measured joint's 1: it moves fifty times as far
)


class BoneLengths:
    """Projects postures onto the segment lengths of a body.

    Newton's method on the length constraints with the shortest step, as SHAKE solves
    them (Ryckaert, Ciccotti & Berendsen 1977, J. Comput. Phys. 23), all at once.

    Args:
        body: Whose lengths they are.
    """

    def __init__(self, body: Body) -> None:
        skeleton = body.skeleton
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._lengths = body.lengths[self._ends]
        self._incidence = np.zeros((len(self._ends), len(skeleton)))
        rows = np.arange(len(self._ends))
        self._incidence[rows, self._ends] = 1.0
        self._incidence[rows, self._starts] = -1.0

    def project(self, positions: Array, trust: Array) -> Array:
        """Return positions with the body's segment lengths.

        Args:
            positions: Joint positions [m], shape (T, J, 3).
            trust: How far each joint is to be trusted, in [0, 1], shape (T, J): an
                invented joint gives way to a measured one.
        """
        projected = positions.copy()
        for first in range(0, len(positions), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            mobility = 1.0 / (trust[chunk] + _FIRMNESS_OF_INVENTED)
            projected[chunk] = self._project(positions[chunk], mobility)
        return projected

    def _project(self, points: Array, mobility: Array) -> Array:
        moves = self._incidence * mobility[:, None, :]
        coupling = moves @ self._incidence.T
        for _ in range(_MOST_STEPS):
            bones = points[:, self._ends] - points[:, self._starts]
            lengths = np.sqrt(np.sum(bones * bones, axis=2))
            error = lengths - self._lengths
            if np.abs(error).max() < _EXACT:
                break
            directions = bones / np.maximum(lengths, 1e-9)[..., None]
            # A step half as long as the bone keeps a folded limb from flipping over.
            error = np.clip(error, -0.5 * self._lengths, 0.5 * self._lengths)
            system = coupling * (directions @ directions.transpose(0, 2, 1))
            system += 1e-9 * np.eye(len(self._ends))
            pull = np.linalg.solve(system, error[..., None])
            points = points - moves.transpose(0, 2, 1) @ (pull * directions)
        return points
