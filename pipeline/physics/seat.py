"""Seats and walls, which bear a body whose target is inside of them.

A performer's seat may be lower than that of the scene, or farther back. Pulls that hold
the body against it would press with many times its weight. So where something stops
trunk or thighs, the target of the upper body moves until the pulls give the body
nothing that things and the floor do not; the feet stay.
"""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, Indices
from kinefilter.retarget.limbs import Reach, at_most

from .holdable import Holdable

# Guesses, tried on seeds 3 to 5 of the scenes with chairs.
_YIELDING_TIME = 0.2  # s in which the target gives way
_FASTER = 4.0  # times as fast at most, under that many body weights or more
_MOST = 0.6  # of what is too much, in a frame: more would swing
_MEMORY = 0.2  # s for which what bore the body still may
_LEAVING_TIME = 0.2  # s in which the target returns to the performer
_LIGHT = 3.0  # kg: lighter things bear nobody
_FARTHEST = 0.3  # m from the performer
_PARTS = ("Knee", "Hip")  # at the ends of thighs, and of what is beside the trunk


class Seat:
    """What bears the trunk and the thighs of a character in a scene.

    ``exists`` is False where nothing but the floor can.
    ``joint_of`` is the joint at the end of each body of the model, -1 if not the
    character's, and ``stiffness`` that of the pulls of each joint [N/m].
    """

    def __init__(
        self, data: mujoco.MjData, body: Body, joint_of: Indices, stiffness: Array
    ) -> None:
        self._data, model, skeleton = data, data.model, body.skeleton
        self._reach = Reach(body)
        ends = [j for part in _PARTS for j in skeleton.sides(part)]
        trunk = [skeleton.root, skeleton.parents[skeleton.girdle], skeleton.girdle]
        self._weight = float(body.mass * GRAVITY)
        self._bears = np.isin(joint_of, [*ends, *trunk])[model.geom_bodyid]
        self._stiffness = float(stiffness[self._reach.upper].sum())
        # Characters have ball joints; they and light things yield themselves.
        balls = model.jnt_type == mujoco.mjtJoint.mjJNT_BALL
        self._roots = model.body_rootid[model.geom_bodyid]
        free = model.body_weldid[model.geom_bodyid] != 0
        light = free & (model.body_subtreemass[self._roots] < _LIGHT)
        alive = np.isin(self._roots, model.body_rootid[model.jnt_bodyid[balls]])
        self._firm = ~(alive | light) & (model.geom_contype != 0)
        self._firm[model.geom("floor").id] = False
        self.exists = bool(self._firm.any())
        self.start()

    def start(self) -> None:
        """Reset the state to a body that nothing bears."""
        self._shift, self._since = np.zeros(3), np.inf

    def take_over(self, other: Seat) -> None:
        """Go on from what bears the same body in another world."""
        self._shift, self._since = other._shift, other._since

    def target(
        self,
        positions: Array,
        rotations: Array,
        dt: float,
        pulled: Array,
        held: Holdable | None,
    ) -> tuple[Array, Array]:
        """Return the target (J, 3) and (J, 4) for a frame of ``dt`` [s].

        ``pulled`` is the force that only the pulls explain [N], (3,). What is ``held``
        bears nobody.
        """
        if not self.exists:
            return positions, rotations
        self._since = 0.0 if self._is_borne(held) else self._since + dt
        if self._since < _MEMORY:
            faster = np.clip(np.linalg.norm(pulled) / self._weight, 1.0, _FASTER)
            share = min(dt / _YIELDING_TIME * faster, _MOST)
            shift = self._shift - share / self._stiffness * pulled
            self._shift = at_most(_FARTHEST, shift)
        else:
            self._shift *= max(0.0, 1.0 - dt / _LEAVING_TIME)
        if np.abs(self._shift).max() < 1e-4:
            return positions, rotations
        return self._reach.shifted(positions, rotations, self._shift)

    def _is_borne(self, held: Holdable | None) -> bool:
        """Return True if something firm, other than the floor, touches the body."""
        geoms = self._data.contact.geom
        touching = self._bears[geoms] & self._firm[geoms[:, ::-1]]
        if held is not None:
            others = self._roots[geoms[:, ::-1]]
            touching &= others != self._data.model.body_rootid[held.body]
        return bool(touching.any())
