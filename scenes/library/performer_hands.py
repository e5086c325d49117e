"""Hands of a performer in MuJoCo's world (z up), for the props that follow them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from kinefilter.characters import Motion
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import rotate, unit, wxyz_from_matrix
from kinefilter.retarget.limbs import smooth_step


@dataclass(frozen=True, eq=False)
class Hands:
    """Both hands over time, left before right."""

    time: Array  # [s], shape (T,)
    positions: Array  # hand joints [m], shape (T, 2, 3)
    elbows: Array  # elbow joints [m], shape (T, 2, 3)
    root: Array  # root joint [m], shape (T, 3)
    head: Array  # height of the head joint [m], shape (T,)
    forward: Array  # direction that the pelvis faces, unit vectors, shape (T, 3)
    radius: float  # of a hand [m]

    @classmethod
    def of(cls, motion: Motion) -> Self:
        """Return the hands of a motion."""
        skeleton = motion.skeleton
        positions = to_mujoco(motion.positions)
        hand, elbow = skeleton.sides("Hand"), skeleton.sides("Elbow")
        pelvis = to_mujoco(motion.rotations[:, skeleton.root])
        return cls(
            time=motion.time,
            positions=positions[:, hand],
            elbows=positions[:, elbow],
            root=positions[:, skeleton.root],
            head=positions[:, skeleton.index("Head"), 2],
            forward=rotate(pelvis, np.array([1.0, 0.0, 0.0])),
            radius=float(motion.body.radii[hand[0]]),
        )

    @property
    def rate(self) -> float:
        """Frames per second."""
        span = float(self.time[-1] - self.time[0])
        return (len(self.time) - 1) / span if span > 0.0 else 30.0

    def frames(self, seconds: float) -> int:
        """Return the number of frames in a duration [s], at least one."""
        return max(1, round(seconds * self.rate))

    @cached_property
    def speed(self) -> Array:
        """Velocity of the hand joints [m/s], shape (T, 2, 3)."""
        if len(self.time) < 2:
            return np.zeros_like(self.positions)
        return np.asarray(np.gradient(self.positions, self.time, axis=0))

    @cached_property
    def middle(self) -> Array:
        """Point halfway between the hands [m], shape (T, 3)."""
        return np.asarray(self.positions.mean(axis=1))

    @cached_property
    def gap(self) -> Array:
        """Distance between the hand joints [m], shape (T,)."""
        return np.asarray(np.linalg.norm(self._line, axis=-1))

    @cached_property
    def ahead(self) -> Array:
        """Distance of the middle in front of the root joint [m], shape (T,)."""
        return np.asarray(np.sum((self.middle - self.root) * self.forward, axis=-1))

    @cached_property
    def reach(self) -> Array:
        """Mean direction of the forearms, across the hands' line, shape (T, 3)."""
        forearms = (self.positions - self.elbows).mean(axis=1)
        line = unit(self._line)
        return unit(forearms - np.sum(forearms * line, axis=-1, keepdims=True) * line)

    @cached_property
    def turn(self) -> Array:
        """Rotation, wxyz, of an object held level, y to the left hand, shape (T, 4)."""
        y = unit(self._line)
        x = unit(np.cross(y, np.array([0.0, 0.0, 1.0])))
        return wxyz_from_matrix(np.stack([x, y, np.cross(x, y)], axis=-1))

    @property
    def _line(self) -> Array:
        return np.asarray(self.positions[:, 0] - self.positions[:, 1])


def fading(time: Array) -> Array:
    """Return a weight that falls smoothly from 1 at 0 s to 0 at 0.3 s, a guess."""
    return 1.0 - smooth_step(time / 0.3)
