"""Limbs that are stuck at the end of a joint's range, where their target cannot reach.

A knee that is bent as far as it goes, after a leg that the tracker turned upwards, is
held there by what pulls it straight down. So is a forearm or a thigh that was left
behind when the body turned around within a frame: the pull turns it the short way,
which its joint does not allow.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array

_AWAY, _TURNED = np.radians(134.0), np.radians(110.0)
"""Angle from where its target points, and angle to the target's rotation, beyond which
a segment is stuck [rad]."""
_PATIENCE = np.array([0.1, 0.5])
"""How long either has to last [s]. Guesses: of 32 recorded takes three get there."""
_LIMB = 0.15  # m: shorter segments, such as thumbs, come back by themselves


class StuckLimbs:
    """Notices limbs of a body that stay turned far away from their targets."""

    def __init__(self, body: Body) -> None:
        long = body.lengths[body.skeleton.segments] > _LIMB
        self._ends = np.array(body.skeleton.segments)[long]
        self._starts = np.array(body.skeleton.segment_parents)[long]
        self._squared = body.lengths[self._ends] ** 2
        self.start()

    def start(self) -> None:
        """Forget all frames."""
        self._lasts = np.zeros(2)

    def step(
        self,
        there: tuple[Array, Array],
        target: tuple[Array, Array],
        elapsed: float,
    ) -> bool:
        """Tell whether a limb is stuck.

        Args:
            there: Joints [m], (J, 3), and rotations of the segments that end at them,
                wxyz, (J, 4).
            target: The same of the target.
            elapsed: Time since the last frame [s].
        """
        bones = [
            points[self._ends] - points[self._starts] for points, _ in (there, target)
        ]
        alike = np.vecdot(there[1][self._ends], target[1][self._ends])
        stuck = (
            np.vecdot(*bones) < np.cos(_AWAY) * self._squared,
            np.abs(alike) < np.cos(0.5 * _TURNED),
        )
        far = np.array([some.any() for some in stuck])
        self._lasts = np.where(far, self._lasts + elapsed, 0.0)
        return bool((self._lasts > _PATIENCE).any())
