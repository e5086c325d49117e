"""Limbs that are stuck where they cannot reach their target.

A knee that is fully bent, after the tracker turned the leg upwards, is held there by
the very pull that should straighten it. So is a forearm or a thigh left behind when the
body turned within a frame: it is pulled the short way, which its joint does not allow.
So is a foot that the other leg turned over. And an arm or a shank whose target went
through another part of the body hangs on that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array

_AWAY, _TURNED = np.radians(134.0), np.radians(110.0)
"""Angle [rad] between a segment's direction and its target's, and between their
rotations, beyond which it is stuck."""
_LEAST_ALIKE = np.cos(0.5 * _TURNED)
_OFF = 0.2
"""Distance [m] of a segment's end from its target, in the frame of the root, beyond
which it is stuck. A hand whose target is inside the body gets nearer than that."""
_TWISTED = np.radians(60.0)
"""Angle [rad] between a foot's direction and its target's beyond which it is stuck, if
its joint could follow: the other leg has turned it over, and the joint keeps it so."""
_PATIENCE = np.array([0.1, 0.5, 0.15, 0.15])
"""How long each has to last [s]. The first two are guesses: three of 32 recorded takes
get there. The distance and its time were chosen on seven walks of p00 to p08 and every
fourth recorded take: 0.11 % of the elbows, wrists, knees and ankles were off by more
than that, and are in 0.03 %; with 25 cm in 0.06 %. Those of feet are from takes of p00
to p08, of whose feet 0.17 % were twisted by more, and are in 0.06 %."""
_LIMB = 0.15  # m: shorter segments, such as thumbs, recover by themselves


class StuckLimbs:
    """Detector of limbs that stay turned far away from their targets."""

    def __init__(self, body: Body) -> None:
        long = body.lengths[body.skeleton.segments] > _LIMB
        self._ends = body.skeleton.segments[long]
        self._starts = body.skeleton.segment_parents[long]
        self._squared = body.lengths[self._ends] ** 2
        self._root = body.skeleton.root
        self._toes = np.array(body.skeleton.sides("Foot"))
        self._ankles = np.array([body.skeleton.parents[toe] for toe in self._toes])
        self._least = np.cos(_TWISTED) * body.lengths[self._toes] ** 2
        self._least_twist = np.cos(0.5 * joint_range("Foot"))
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._lasted = np.zeros(len(_PATIENCE))

    def step(
        self,
        pose: tuple[Array, Array],
        target: tuple[Array, Array],
        elapsed: float,
        blocked: Callable[[], bool],
    ) -> bool:
        """Return True if a limb is stuck, ``elapsed`` [s] after the last frame.

        Pose and target are joint positions [m], (J, 3), and rotations, wxyz, (J, 4). A
        body that is ``blocked`` by something else may be away from its target.
        """
        ends, starts, off = self._ends, self._starts, pose[0] - target[0]
        alike = np.abs(np.vecdot(pose[1][ends], target[1][ends]))
        turned = bool(alike.min() < _LEAST_ALIKE)
        off = off[ends] - off[self._root]
        far = bool(np.vecdot(off, off).max() > _OFF**2) and not blocked()
        own, wanted = (p[self._toes] - p[self._ankles] for p in (pose[0], target[0]))
        feet = np.vecdot(own, wanted) < self._least
        if twisted := bool(feet.any()):
            twists = np.abs(np.vecdot(target[1][self._toes], target[1][self._ankles]))
            twisted = bool((feet & (twists >= self._least_twist)).any())
        if not (turned or far or twisted):  # and so none points away either
            self._lasted[:] = 0.0
            return False
        own, wanted = (points[ends] - points[starts] for points, _ in (pose, target))
        away = np.vecdot(own, wanted) < np.cos(_AWAY) * self._squared
        stuck = np.array([away.any(), turned, far, twisted])
        self._lasted = np.where(stuck, self._lasted + elapsed, 0.0)
        return bool((self._lasted > _PATIENCE).any())
