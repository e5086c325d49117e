"""The force that only the pulls explain, from the momentum that the character gains."""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters.arrays import Array, Indices


class Momentum:
    """Balance of the character's linear momentum over each frame, in MuJoCo's world.

    The engine reports the forces at the beginning of a substep but integrates others,
    as it evaluates damping at its end. So what the pulls gave is computed from the
    momentum that was gained. ``masses`` [kg] move with the sites at the joints, both
    (J,); ``pulls`` are its actuators.
    """

    def __init__(
        self,
        data: mujoco.MjData,
        sites: Indices,
        masses: Array,
        root: int,
        pulls: slice,
    ) -> None:
        self._data, model = data, data.model
        first = int(model.body_dofadr[root])
        whole = slice(first, first + 3)  # these forces act on the whole body
        # Views of the engine's memory: reading an attribute makes a new one.
        self._given = data.qfrc_constraint[whole], data.qfrc_actuator[whole]
        self._pulling, self._places = data.actuator_force[pulls], data.site_xpos
        self._directions = model.actuator_gear[pulls, :3].copy()
        self._upward = self._directions[:, 2].copy()
        strongest = np.abs(model.actuator_forcerange[pulls]).max(axis=1)
        self._most = strongest @ np.abs(self._directions)
        self._sites, self._masses = sites, np.zeros(model.nsite)
        self._masses[sites] = masses
        self._gravity = float(masses.sum()) * model.opt.gravity
        self.start()

    def start(self) -> None:
        """Reset the state to a body at rest."""
        self._before = np.zeros(3)
        self.forget()

    def set_off(self, velocities: Array) -> None:
        """Set the velocities of the joints [m/s], (J, 3), at which the body begins."""
        self._before = self._masses[self._sites] @ velocities

    def take_over(self, other: Momentum) -> None:
        """Go on from the momentum of the same body in another world."""
        self._before = other._before

    def forget(self) -> None:
        """Forget the forces that were added, because the frame is simulated again."""
        self._forces, self._pulled = np.zeros(3), np.zeros(len(self._pulling))
        self.steps = 0

    def add(self) -> None:
        """Add the forces of a substep: of the floor, props, ties and pulls."""
        self.steps += 1
        for forces in self._given:
            self._forces += forces
        self._pulled += self._pulling

    @property
    def lifting(self) -> float:
        """Upward force of all pulls in the last substep [N]."""
        return float(self._pulling @ self._upward)

    def note(self) -> None:
        """Note where the body was before the last substep.

        To be called before the kinematics of the data are brought up to date.
        """
        self._there = self._masses @ self._places

    def unexplained(self, pushed: Array) -> Array:
        """Return the mean force [N], (3,), since the last call that only pulls explain.

        That is, not contacts, ties, gravity or pushes, of which the sum (3,) is given.
        No more than the pulls can give: where the body was put into things by a reset,
        contacts explode for a frame.
        """
        model = self._data.model
        step = model.opt.timestep
        momentum = (self._masses @ self._places - self._there) / step
        explained = (self._forces - self._pulled @ self._directions) / self.steps
        gained = (momentum - self._before) / (step * self.steps)
        self.start()
        self._before = momentum
        force = gained - self._gravity - explained - pushed
        return np.asarray(force.clip(-self._most, self._most))
