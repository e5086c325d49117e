"""The physics filter: a capsule humanoid pulled through the corrected motion.

MuJoCo takes the place of the papers' ODE (Shum 2013, section VII): bounded PD forces
pull every joint to its target while the engine keeps segment lengths, ball joints,
gravity and the floor, so the result obeys them whatever the target does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body
from kinefilter.characters.humanoid import (
    GRAVITY,
    Tracking,
    build_humanoid,
    from_mujoco,
    to_mujoco,
)
from kinefilter.retarget.kinematics import positions_from_rotations
from kinefilter.retarget.rotations import (
    inverse,
    multiply,
    normalize,
    rotate,
    rotation_vector,
)

__all__ = ["PhysicsFilter", "PhysicsResult", "PhysicsTrace", "substeps_in"]

Array = NDArray[np.float64]

SUBSTEP = 1.0 / 240.0
"""Longest simulation step [s]: omega * dt = 0.25 at the default tracking. At 1/120 one
in six recorded takes of punches and kicks diverged somewhere."""
LOST = 3.0
"""A joint this far [m] from its target means that the simulation went astray: more than
the longest jump of a tracker that the bounded forces are still catching up with."""
_FASTEST = 1e3  # rad/s or m/s: nothing on a body is ever that fast


@dataclass(frozen=True)
class PhysicsTrace:
    """What the simulation did, frame by frame; arrays of shape (T,)."""

    tracking_error: Array
    """Mean distance of the joints from their targets [m]."""
    external_force: Array
    """Sum of the magnitudes of the pulling forces [body weights]."""
    contacts: NDArray[np.int64]
    """Number of contact points with the floor."""
    reset: NDArray[np.bool_]
    """The step diverged; the character was put back onto its target."""

    @property
    def status(self) -> str:
        """``ok``, or how many frames had to be reset."""
        resets = int(self.reset.sum())
        return "ok" if resets == 0 else f"{resets} diverging frames reset"


@dataclass(frozen=True)
class PhysicsResult:
    """The simulated motion."""

    rotations: Array
    """World segment rotations, wxyz, shape (T, J, 4)."""
    positions: Array
    """Joint positions [m], world frame, shape (T, J, 3)."""
    trace: PhysicsTrace
    """What happened in each frame."""


def substeps_in(dt: float) -> int:
    """Return into how many simulation steps a frame of ``dt`` [s] is divided."""
    return max(1, int(np.ceil(dt / SUBSTEP - 1e-3)))


class PhysicsFilter:
    """Steps the humanoid of one body, frame by frame."""

    def __init__(self, body: Body, tracking: Tracking | None = None) -> None:
        self.body = body
        self.model = build_humanoid(body, tracking).compile()
        self.data = mujoco.MjData(self.model)
        joints = body.skeleton.joints
        n = len(joints)
        self._sites = np.array([self.model.site(name).id for name in joints])
        self._bodies = np.array([self.model.body(name).id for name in joints])
        self._segments = body.skeleton.segments
        self._parents = body.skeleton.segment_parents
        self._balls = np.array(
            [self.model.joint(joints[j]).qposadr[0] for j in self._segments]
        )
        self._stiffness = -self.model.actuator_biasprm[:, 1]
        self._damping = -self.model.actuator_biasprm[:, 2]
        turns = slice(3 * n, None)
        self._turn_axes = self.model.actuator_gear[turns, 3:]
        # The first three torques are the root's, then one a segment.
        turned = [
            self.model.actuator(i).name.split(":")[1]
            for i in range(3 * n, self.model.nu)
        ]
        self._turned = np.array([joints.index(name) for name in turned])
        self._weight = float(body.mass * GRAVITY)
        if mujoco.get_mju_user_warning() is None:
            # The engine's own handler writes a log into the user's working folder; a
            # diverging step is in the trace.
            mujoco.set_mju_user_warning(lambda _: None)

    def start(self, positions: Array, rotations: Array) -> None:
        """Put the character at rest onto a target posture.

        Args:
            positions: Target joint positions [m], world frame, shape (J, 3).
            rotations: Target world segment rotations, wxyz, shape (J, 4).
        """
        mujoco.mj_resetData(self.model, self.data)
        self._target = (to_mujoco(positions), to_mujoco(rotations))
        self._place(*self._target)

    def step(self, positions: Array, rotations: Array, dt: float) -> bool:
        """Advance by dt [s] towards a target; return False if it had to be reset.

        The posture is then in ``self.rotations`` and ``self.root``.
        """
        before_p, before_q = self._target
        after_p, after_q = to_mujoco(positions), to_mujoco(rotations)
        after_q = np.where(
            np.sum(before_q * after_q, axis=1, keepdims=True) < 0, -after_q, after_q
        )
        self._target = (after_p, after_q)
        substeps = substeps_in(dt)
        self.model.opt.timestep = dt / substeps
        n = after_p.size
        velocity = ((after_p - before_p) / dt).ravel()
        spin = rotation_vector(multiply(after_q, inverse(before_q))) / dt
        turning = rotate(inverse(after_q), spin)[self._turned]
        feed_forward = self._damping * np.concatenate(
            [velocity, np.sum(turning * self._turn_axes, axis=1)]
        )
        ctrl, data = self.data.ctrl, self.data
        ctrl[n:] = feed_forward[n:]
        for k in range(substeps):
            # The engine compares the target with the state at the step's beginning.
            share = k / substeps
            point = before_p + share * (after_p - before_p)
            ctrl[:n] = self._stiffness[:n] * point.ravel() + feed_forward[:n]
            data.mocap_quat[:] = normalize(before_q + share * (after_q - before_q))
            mujoco.mj_step(self.model, data)
            if not np.abs(data.qvel).max() < _FASTEST:  # also true for NaN
                break
        mujoco.mj_kinematics(self.model, data)
        if self._astray(after_p):
            mujoco.mj_resetData(self.model, data)
            self._place(after_p, after_q)
            return False
        return True

    def _astray(self, target: Array) -> bool:
        """Tell whether the character spins out of control or left its target."""
        bad = (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQVEL)
        if any(self.data.warning[kind].number for kind in bad):
            return True
        if not np.abs(self.data.qvel).max() < _FASTEST:
            return True
        away = np.abs(self.data.site_xpos[self._sites] - target).max()
        return not away < LOST  # also true for NaN

    def _place(self, positions: Array, rotations: Array) -> None:
        root = self.body.skeleton.root
        qpos = self.data.qpos
        qpos[:3], qpos[3:7] = positions[root], rotations[root]
        relative = multiply(
            inverse(rotations[self._parents]), rotations[self._segments]
        )
        qpos[self._balls[:, None] + np.arange(4)] = relative
        self.data.qvel[:] = 0.0
        self.data.mocap_quat[:] = rotations
        mujoco.mj_kinematics(self.model, self.data)

    @property
    def rotations(self) -> Array:
        """World segment rotations of the present posture, wxyz, shape (J, 4)."""
        return from_mujoco(self.data.xquat[self._bodies])

    @property
    def root(self) -> Array:
        """Position of the root joint [m], world frame, shape (3,)."""
        return from_mujoco(self.data.qpos[:3])

    @property
    def external_force(self) -> float:
        """Sum of the magnitudes of the forces that pull the parts [body weights]."""
        n = 3 * len(self._sites)
        forces = self.data.actuator_force[:n].reshape(-1, 3)
        return float(np.linalg.norm(forces, axis=1).sum() / self._weight)

    @property
    def tracking_error(self) -> float:
        """Mean distance of the joints from their targets [m]."""
        away = self.data.site_xpos[self._sites] - self._target[0]
        return float(np.linalg.norm(away, axis=1).mean())

    def run(
        self,
        time: Array,
        positions: Array,
        rotations: Array,
        *,
        frames: Iterable[int] | None = None,
    ) -> PhysicsResult:
        """Pull the character through a whole motion.

        Args:
            time: Time stamps [s], strictly increasing, shape (T,).
            positions: Target joint positions [m], world frame, shape (T, J, 3).
            rotations: Target world segment rotations, wxyz, shape (T, J, 4).
            frames: Yields 0 to T - 1, e.g. a progress bar's iterator.
        """
        count = len(time)
        result = np.empty_like(rotations)
        joints = np.empty_like(positions)
        trace = PhysicsTrace(
            np.zeros(count),
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=np.bool_),
        )
        for k in range(count) if frames is None else frames:
            if k == 0:
                self.start(positions[0], rotations[0])
                self._settle(float(time[1] - time[0]) if count > 1 else 1 / 30)
            else:
                dt = float(time[k] - time[k - 1])
                trace.reset[k] = not self.step(positions[k], rotations[k], dt)
            result[k] = self.rotations
            if k > 0:  # neighbors on one hemisphere
                dots = np.sum(result[k] * result[k - 1], axis=1, keepdims=True)
                result[k] *= np.where(dots < 0.0, -1.0, 1.0)
            joints[k] = positions_from_rotations(result[k], self.root, self.body)
            trace.tracking_error[k] = self.tracking_error
            trace.external_force[k] = self.external_force
            trace.contacts[k] = self.data.ncon
        return PhysicsResult(result, joints, trace)

    def _settle(self, dt: float) -> None:
        """Hold the first target until the start-up transient is gone."""
        positions, rotations = (from_mujoco(value) for value in self._target)
        for _ in range(int(np.ceil(0.5 / dt))):
            self.step(positions, rotations, dt)
