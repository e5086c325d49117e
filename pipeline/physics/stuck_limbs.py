"""Limbs stuck at the end of a joint's range, where they cannot reach their target.

A knee that is fully bent, after the tracker turned the leg upwards, is held there by
the very pull that should straighten it. So is a forearm or a thigh left behind when the
body turned within a frame: it is pulled the short way, which its joint does not allow.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array

_AWAY, _TURNED = np.radians(134.0), np.radians(110.0)
"""Angle [rad] between a segment's direction and its target's, and between their
rotations, beyond which it is stuck."""
_PATIENCE = np.array([0.1, 0.5])
"""How long either has to last [s]. Guesses: three of 32 recorded takes get there."""
_LIMB = 0.15  # m: shorter segments, such as thumbs, recover by themselves


class StuckLimbs:
    """Detector of limbs that stay turned far away from their targets."""

    def __init__(self, body: Body) -> None:
        long = body.lengths[body.skeleton.segments] > _LIMB
        self._ends = body.skeleton.segments[long]
        self._starts = body.skeleton.segment_parents[long]
        self._squared = body.lengths[self._ends] ** 2
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._lasted = np.zeros(2)

    def step(
        self, pose: tuple[Array, Array], target: tuple[Array, Array], elapsed: float
    ) -> bool:
        """Return True if a limb is stuck, ``elapsed`` [s] after the last frame.

        Pose and target are joint positions [m], (J, 3), and rotations, wxyz, (J, 4).
        """
        alike = np.vecdot(pose[1][self._ends], target[1][self._ends])
        turned = np.abs(alike) < np.cos(0.5 * _TURNED)
        if not turned.any():  # and so none points away either
            self._lasted[:] = 0.0
            return False
        ends, starts = self._ends, self._starts
        own, wanted = (points[ends] - points[starts] for points, _ in (pose, target))
        away = np.vecdot(own, wanted) < np.cos(_AWAY) * self._squared
        stuck = np.array([away.any(), True])
        self._lasted = np.where(stuck, self._lasted + elapsed, 0.0)
        return bool((self._lasted > _PATIENCE).any())
