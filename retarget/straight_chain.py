"""Chains of short bones taken for one straight segment.

The bones of hands and neck are hardly longer than a tracker's errors, so none of them
shows where it points. Together they do: joints count by their distance from the start
of the chain, and where none is reliable, the chain continues the segment before it.
"""

from collections.abc import Sequence

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import inverse, rotate, unit

# Chosen on 24 simulated takes, half of them with hands that bend and turn.
_ODD = 1.2  # distance from a straight chain, relative to length, that halves its weight


class StraightChains:
    """Chains that each start at a joint, in the frame of the segment that ends there.

    Args:
        body: The person's body.
        starts: The joints at which the K chains start.
        joints: For each place along the chains the K joints there.
        straight: Weight of a straight chain, against 1 of a reliable one that bends.
        bend: Angle [rad] to which chains bend freely, and one that they never reach.
    """

    def __init__(
        self,
        body: Body,
        starts: Sequence[int],
        joints: Sequence[Sequence[int]],
        *,
        straight: float,
        bend: tuple[float, float],
    ) -> None:
        self.starts, self.joints = np.array(starts), np.array(joints)
        self.along = body.directions[self.joints[0]]
        self._straight, self._bend = straight, bend
        self._reach = np.cumsum(body.lengths[self.joints], axis=0)
        self._whole = np.sum(self._reach**2, axis=0)

    def aims(
        self, positions: Array, rotations: Array, weights: Array
    ) -> tuple[Array, Array]:
        """Return where chains point, and how reliably, in [0, 1] for weights up to 1.

        Args:
            positions: Joint positions [m], shape (..., J, 3).
            rotations: World rotations of the segments, wxyz, shape (..., J, 4).
            weights: Weight of each joint, above 0, shape (..., J).

        Returns:
            Least-squares directions in the frames of the segments before, (..., K, 3),
            shorter than 1 as far as the joints disagree, and their weights, (..., K),
            less for chains that bend far, most of which the tracker has lost.
        """
        bones = positions[..., self.joints, :] - positions[..., None, self.starts, :]
        pulls = weights[..., self.joints] * self._reach
        total = (pulls * self._reach).sum(axis=-2)
        mean = (pulls[..., None] * bones).sum(axis=-3) / total[..., None]
        aims = rotate(inverse(rotations[..., self.starts, :]), mean)
        bent = aims - self.along
        odd = np.vecdot(bent, bent) / _ODD**2
        return aims, total / self._whole / (1.0 + odd)

    def straightened(self, aims: Array, weights: Array) -> Array:
        """Return unit directions of chains (..., K, 3) that resist bending.

        Arguments are results of ``aims``.
        """
        mixed = unit(weights[..., None] * aims + self._straight * self.along)
        bend = np.arccos(np.vecdot(mixed, self.along).clip(-1.0, 1.0))
        away = unit(mixed - np.cos(bend)[..., None] * self.along)
        less = softened(bend, *self._bend)[..., None]
        return np.asarray(np.cos(less) * self.along + np.sin(less) * away)


def softened(angle: Array, free: float, most: float) -> Array:
    """Return angles [rad] that stay up to ``free`` and never reach ``most``.

    Negative ones are bounded likewise.
    """
    room, size = most - free, np.abs(angle)
    less = free + room * np.tanh((size - free) / room)
    return np.where(size > free, np.sign(angle) * less, angle)
