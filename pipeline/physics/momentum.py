"""What the pulls give the character as a whole, from the momentum that it gains."""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.humanoid import PULLS


class Momentum:
    """Balances the character's linear momentum over each frame, in MuJoCo's world.

    The forces that the engine tells are those at the beginning of a substep. It
    integrates others, as damping counts at the end of the substep, unless a force is at
    its bound: what was gained is what was given.

    Args:
        model: A compiled scene.
        sites: The sites at the character's joints, shape (J,).
        masses: What moves with each of them [kg], shape (J,).
        root: The character's root body.
    """

    def __init__(
        self, model: mujoco.MjModel, sites: Indices, masses: Array, root: int
    ) -> None:
        first = int(model.body_dofadr[root])
        self._root = slice(first, first + 3)  # whose forces act on all that hangs on it
        self._sites, self._masses = sites, masses
        self._pulls = np.flatnonzero(model.actuator_group == PULLS)
        self._ends = model.actuator_gear[self._pulls, :3]
        self._gravity = float(masses.sum()) * model.opt.gravity
        self.start()

    def start(self) -> None:
        """Begin at rest."""
        self._before, self._steps = np.zeros(3), 0
        self._given, self._drawn = np.zeros(3), np.zeros(len(self._pulls))

    def add(self, data: mujoco.MjData) -> None:
        """Take in a substep: what floor, things and grips gave."""
        self._steps += 1
        self._given += data.qfrc_constraint[self._root] + data.qfrc_actuator[self._root]
        self._drawn += data.actuator_force[: len(self._pulls)]

    def beyond(self, data: mujoco.MjData, pushed: Array) -> Array:
        """Return the mean force [N] that neither these, gravity nor pushes gave, (3,).

        Over the substeps since the last call, of which the state is that after the
        last; afterwards its kinematics is up to date.
        """
        there, model = data.site_xpos[self._sites], data.model
        mujoco.mj_kinematics(model, data)
        step = model.opt.timestep
        momentum = self._masses @ (data.site_xpos[self._sites] - there) / step
        given = (self._given - self._drawn @ self._ends) / self._steps
        gained = (momentum - self._before) / (step * self._steps)
        self.start()
        self._before = momentum
        return np.asarray(gained - self._gravity - given - pushed)
