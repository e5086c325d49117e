"""Moves from one target posture to the next, with the forces that they need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from kinefilter.characters import Body, InputError, Skeleton
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import inverse, multiply, rotation_vector
from kinefilter.pipeline.target.feet import ankles_and_toes

from .compliance import relative_rotations

_UP = np.array([0.0, 0.0, 1.0])


def check_target(positions: Array, rotations: Array) -> None:
    """Raise an InputError if a target, or one of several, is not finite."""
    # A single NaN would spoil every later step.
    if not (np.isfinite(positions).all() and np.isfinite(rotations).all()):
        raise InputError("the target is not finite; correct the frame or skip it")


@dataclass(frozen=True, eq=False)
class Move:
    """The way from one target to the next, in MuJoCo's world; several have axis T."""

    duration: Any  # time that it takes [s]
    before: tuple[Array, Array]  # joints [m] and rotations, wxyz, (J, 3) and (J, 4)
    after: tuple[Array, Array]  # the same at its end
    forward: Array  # controls of the pulls that the pose does not change, (pulls,)
    left_share: Any  # of the body that the left foot bears if both stand, in [0, 1]

    @property
    def velocity(self) -> Array:
        """The joints' mean velocity [m/s], shape (J, 3), of a single move."""
        return np.asarray((self.after[0] - self.before[0]) / self.duration)

    @property
    def speed(self) -> float:
        """Speed of the fastest joint [m/s], of a single move."""
        return float(np.linalg.norm(self.velocity, axis=1).max())

    def __getitem__(self, k: int) -> Move:
        """Return one of several moves."""
        before, after = ((p[k], q[k]) for p, q in (self.before, self.after))
        share = float(self.left_share[k])
        return Move(float(self.duration[k]), before, after, self.forward[k], share)


class Coordinates:
    """Where one of the characters in a model is in the engine's coordinates."""

    def __init__(
        self, model: mujoco.MjModel, skeleton: Skeleton, names: Sequence[str]
    ) -> None:
        self._model, self._skeleton = model, skeleton
        ends = [model.joint(names[j]) for j in skeleton.segments]
        self._balls = np.array([ball.qposadr[0] for ball in ends])[:, None] + range(4)
        free = model.joint(names[skeleton.root])
        first, speed = int(free.qposadr[0]), int(free.dofadr[0])
        self.root = slice(first, first + 7)
        self.places = slice(first, first + 7 + 4 * len(ends))
        self.speeds = slice(speed, speed + 6 + 3 * len(ends))

    def pose(self, qpos: Array, positions: Array, rotations: Array) -> None:
        """Write a posture, joints [m] (J, 3) and rotations (J, 4), into ``qpos``."""
        root = self._skeleton.root
        qpos[self.root] = np.concatenate([positions[root], rotations[root]])
        relative = relative_rotations(rotations, self._skeleton)
        qpos[self._balls] = relative[self._skeleton.segments]

    def speeds_of(self, qpos: Array, move: Move) -> Array:
        """Return the speeds of a move, in a world whose other places are ``qpos``."""
        before, after, speeds = qpos.copy(), qpos.copy(), np.empty(self._model.nv)
        self.pose(before, *move.before)
        self.pose(after, *move.after)
        mujoco.mj_differentiatePos(self._model, speeds, move.duration, before, after)
        return speeds[self.speeds]


class MovePlanner:
    """Plans the moves of one body.

    Each torque of the pulls acts on a joint of ``turned`` (N,), about an axis in the
    frame of its segment (N, 3). ``damping`` of the pulls (pulls,) can be set.
    """

    def __init__(
        self, body: Body, turned: Indices, axes: Array, damping: Array
    ) -> None:
        masses = joint_masses(body)
        self._masses, self._shares = masses[:, None], masses / masses.sum()
        self._feet = np.transpose(ankles_and_toes(body.skeleton))
        self._turned, self._turn_axes, self.damping = turned, axes, damping

    def __call__(
        self,
        before: tuple[Array, Array],
        after: tuple[Array, Array],
        acceleration: Array,
        duration: Any,
        share: float = 1.0,
    ) -> Move:
        """Return the move between two targets, as in ``Move``, or several in a row.

        The acceleration of the joints [m/s^2] has the shape of their positions. The
        pulls carry a ``share`` of what is needed.
        """
        seconds = np.asarray(duration)[..., None]
        opposite = np.vecdot(before[1], after[1]) < 0.0
        after = after[0], np.where(opposite[..., None], -after[1], after[1])
        # In the segment's own frame, as the torques' axes are.
        turning = rotation_vector(multiply(inverse(before[1]), after[1]))
        turns = np.vecdot(turning[..., self._turned, :], self._turn_axes)
        needed = self._masses * (acceleration + _UP * GRAVITY) * share
        rows = (*needed.shape[:-2], -1)
        moved = [(after[0] - before[0]).reshape(rows), turns]
        forward = self.damping * (np.concatenate(moved, axis=-1) / seconds)
        forward[..., : len(self._masses) * 3] += needed.reshape(rows)
        # By where the center of mass is between the feet.
        feet = 0.5 * after[0][..., self._feet, :2].sum(axis=-2)
        left, right = feet[..., 0, :], feet[..., 1, :]
        across, middle = left - right, self._shares @ after[0][..., :2]
        left_share = np.vecdot(middle - right, across)
        left_share = left_share / np.maximum(np.vecdot(across, across), 1e-6)
        return Move(duration, before, after, forward, left_share.clip(0.0, 1.0))
