"""The physics filter: a capsule humanoid pulled through the corrected motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import positions_from_rotations
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import continuous

from .pulled_character import PulledCharacter
from .things import Things

_SETTLING = 10  # frames of 1/30 s: longer than a foot takes to bear the body
_CHUNK = 4096  # frames at a time, to bound the memory


@dataclass(frozen=True, eq=False)
class PhysicsTrace:
    """What the simulation did, frame by frame; arrays of shape (T,)."""

    tracking_error: Array
    """Mean distance of the joints from their targets [m]."""
    external_force: Array
    """Force on the body that no muscle and no floor gives [body weights]."""
    contacts: NDArray[np.int64]
    """Number of points in which the character touches itself or anything else."""
    reset: NDArray[np.bool_]
    """The step diverged; the character was put back onto its target."""

    @property
    def status(self) -> str:
        """``ok``, or how many frames had to be reset."""
        resets = int(self.reset.sum())
        return "ok" if resets == 0 else f"{resets} diverging frames reset"


@dataclass(frozen=True, eq=False)
class PhysicsResult:
    """The simulated motion."""

    rotations: Array
    """World segment rotations, wxyz, shape (T, J, 4)."""
    positions: Array
    """Joint positions [m], world frame, shape (T, J, 3)."""
    trace: PhysicsTrace
    """What happened in each frame."""
    things: Things
    """What else was in the scene, in the frame of the targets."""


class PhysicsFilter(PulledCharacter):
    """Pulls the humanoid of one body through whole motions."""

    def run(
        self,
        time: Array,
        positions: Array,
        rotations: Array,
        *,
        stands: NDArray[np.bool_] | None = None,
        frames: Iterable[int] | None = None,
    ) -> PhysicsResult:
        """Pull the character through a whole motion.

        Args:
            time: Time stamps [s], strictly increasing, shape (T,).
            positions: Target joint positions [m], world frame, shape (T, J, 3).
            rotations: Target world segment rotations, wxyz, shape (T, J, 4).
            stands: Whether each foot (left, right) bears weight, shape (T, 2).
            frames: Yields 0 to T - 1, e.g. a progress bar's iterator.
        """
        count = len(time)
        accelerations = _accelerations(time, positions)
        result = np.empty_like(rotations)
        roots = np.empty((count, 3))
        trace = PhysicsTrace(
            np.zeros(count),
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=np.bool_),
        )
        character = int(self._bodies[self.body.skeleton.root])
        things = Things(self.model, self.data, character, count)
        for k in range(count) if frames is None else frames:
            if k == 0:
                self.start(positions[0], rotations[0])
                self._settle(None if stands is None else stands[0])
            else:
                dt = float(time[k] - time[k - 1])
                trace.reset[k] = not self.step(
                    positions[k],
                    rotations[k],
                    dt,
                    acceleration=accelerations[k],
                    stands=None if stands is None else stands[k],
                )
            result[k] = self.rotations
            roots[k] = self.root
            trace.tracking_error[k] = self.tracking_error
            trace.external_force[k] = self.external_force
            trace.contacts[k] = self.contacts
            things.record(k)
        result = continuous(result)
        joints = np.empty_like(positions)
        for k in range(0, count, _CHUNK):
            some = slice(k, k + _CHUNK)
            joints[some] = positions_from_rotations(
                result[some], roots[some], self.body
            )
        return PhysicsResult(result, joints, trace, things)

    def _settle(self, stands: NDArray[np.bool_] | None) -> None:
        """Hold the first target until the start-up transient is gone."""
        positions, rotations = (from_mujoco(value) for value in self._target)
        for _ in range(_SETTLING):
            self.step(positions, rotations, 1 / 30, stands=stands)


def _accelerations(time: Array, positions: Array) -> Array:
    """Return accelerations [m/s^2] of a motion, of which each step knows the next."""
    found = np.zeros_like(positions)
    if len(time) > 2:
        steps = np.diff(time)
        velocities = np.diff(positions, axis=0) / steps[:, None, None]
        found[1:-1] = (velocities[1:] - velocities[:-1]) / (
            0.5 * (steps[1:] + steps[:-1])
        )[:, None, None]
    return found
