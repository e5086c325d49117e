"""The character in MuJoCo's world, pulled to one target posture after another.

MuJoCo takes the place of the papers' ODE (Shum 2013, section VII): bounded PD forces
pull every joint to its target while the engine keeps segment lengths, ball joints,
gravity and the floor, so the result obeys them whatever the target does.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body, InputError, Tracking
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Flags, as_number, as_numbers
from kinefilter.characters.humanoid import PULLS, build_humanoid, from_mujoco, to_mujoco
from kinefilter.characters.rotations import IDENTITY, inverse, multiply, rotation_vector
from kinefilter.characters.tracking import GameTracking, RagdollTracking
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.floor import clearances, sunk
from kinefilter.scenes import load_scene

from .compliance import TENSION, Compliance
from .momentum import Momentum
from .stuck_limbs import StuckLimbs

_UP = np.array([0.0, 0.0, 1.0])
UPDATE = 1.0 / 60.0
"""Longest time [s] between two updates of what the actuators pull to."""
_LETS_GO = 0.08  # m that hands are to be farther apart than what they hold is wide
_LOADING_TIME = 0.2  # s from a foot's touching the floor to its bearing the body
_HARDEST_STEP = 2.0  # body weights that a foot presses with. A guess: running, landing
SUBSTEP = 1.0 / 240.0
"""Longest simulation step [s]: omega * dt = 0.25 at the default tracking. At 1/120 one
in six recorded takes of punches and kicks diverged somewhere."""
LOST = 3.0
"""A joint this far [m] from its target means that the simulation went astray: more than
the longest jump of a tracker that the bounded forces are still catching up with."""
_FASTEST = 1e3  # rad/s or m/s: nothing on a body is ever that fast


def steps_in(dt: float) -> tuple[int, int]:
    """Return how many updates are in a frame of ``dt`` [s], and steps in an update."""
    updates = max(1, int(np.ceil(dt / UPDATE - 1e-3)))
    return updates, max(1, int(np.ceil(dt / (updates * SUBSTEP) - 1e-3)))


def _check_target(positions: Array, rotations: Array) -> None:
    # One number that is not finite would spoil every later step.
    if not (np.isfinite(positions).all() and np.isfinite(rotations).all()):
        raise InputError(
            "the target has numbers that are not finite; correct the frame first, "
            "or leave it out"
        )


class PulledCharacter:
    """Steps the humanoid of one body, frame by frame.

    It stands in T-pose at the origin until ``start`` puts it elsewhere. Targets are
    joint positions [m], world frame, shape (J, 3), and world segment rotations, wxyz,
    shape (J, 4).

    Args:
        body: The person.
        tracking: How hard the character is pulled.
        scene: What is around it, one of SCENES or an MJCF file; by default the floor.
        more: Adds to the scene before it is compiled.

    Raises:
        InputError: As ``load_scene``.
    """

    def __init__(
        self,
        body: Body,
        tracking: Tracking | None = None,
        *,
        scene: str | Path | None = None,
        more: Callable[[mujoco.MjSpec], object] = lambda _: None,
    ) -> None:
        self.body = body
        if scene is None:
            spec = build_humanoid(body, tracking)
        else:
            spec = load_scene(scene, body, tracking=tracking)
        more(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        joints = body.skeleton.joints
        n = len(joints)
        self._sites = np.array([self.model.site(name).id for name in joints])
        self._bodies = np.array([self.model.body(name).id for name in joints])
        self._balls = np.array(
            [self.model.joint(joints[j]).qposadr[0] for j in body.skeleton.segments]
        )
        # The character's actuators come first: forces, then torques, of which the first
        # three are the root's, then one a segment.
        count = int(np.sum(self.model.actuator_group == PULLS))
        self._stiffness = -self.model.actuator_biasprm[:count, 1]
        self._damping = -self.model.actuator_biasprm[:count, 2]
        turns = range(3 * n, count)
        self._turn_axes = self.model.actuator_gear[turns, 3:]
        turned = [self.model.actuator(i).name.split(":")[1] for i in turns]
        targets = [self.model.body(f"target:{name}").id for name in joints]
        self._mocap = self.model.body_mocapid[targets]
        self._turned = np.array([joints.index(name) for name in turned])
        self._palms = body.skeleton.sides("Hand")
        self._hands = self._bodies[self._palms]
        grips = [f"grip:{joints[palm]}" for palm in self._palms]
        self._grips = [self.model.actuator(grip).id for grip in grips]
        self._own = np.isin(self.model.geom_bodyid, self._bodies)
        self._props = np.isin(
            self.model.body_rootid,
            self.model.jnt_bodyid[
                (self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
                & (self.model.jnt_bodyid != self._bodies[body.skeleton.root])
            ],
        )
        self._weight = float(body.mass * GRAVITY)
        self._masses = joint_masses(body)[:, None]
        self._shares = self._masses[:, 0] / self._masses.sum()
        self._momentum = Momentum(
            self.model,
            self._sites,
            self._masses[:, 0],
            int(self._bodies[body.skeleton.root]),
        )
        self._clearance, self._limbs = clearances(body), StuckLimbs(body)
        ankles, toes = ankles_and_toes(body.skeleton)
        self._feet = np.stack([ankles, toes], axis=1)
        self._soles = self._bodies[toes]
        self._load = np.zeros(2)
        self._pushes: list[tuple[int, Array, float]] = []
        self._gains = self._stiffness, self._damping
        self._resists = self.model.dof_damping.copy()
        # For each body of the model the joint at its end, -1 if not the character's.
        self.parts = np.full(self.model.nbody, -1)
        self.parts[self._bodies] = np.arange(n)
        self.compliance = None
        if isinstance(tracking, GameTracking):
            self.compliance = Compliance(body, tracking)
        self.limp = isinstance(tracking, RagdollTracking)
        if mujoco.get_mju_user_warning() is None:
            # The engine's own handler writes a log into the user's working folder; a
            # diverging step is in the trace.
            mujoco.set_mju_user_warning(lambda _: None)
        self.start(body.rest_positions, np.tile(IDENTITY, (n, 1)))

    def start(self, positions: Array, rotations: Array, *, anew: bool = True) -> None:
        """Put the character at rest onto a target posture.

        Args:
            positions: The target's joint positions.
            rotations: The target's rotations.
            anew: Whether what is around it goes back to where the scene has it, too;
                otherwise it comes to rest where it is.

        Raises:
            InputError: The target is not finite.
        """
        _check_target(positions, rotations)
        there = self.data.qpos.copy()
        mujoco.mj_resetData(self.model, self.data)
        if not anew:
            self.data.qpos[:] = there
        self._target = (to_mujoco(positions), to_mujoco(rotations))
        self._velocity = np.zeros_like(self._target[0])
        self._load[:], self._pressure = 0.0, 0.0
        self._momentum.start()
        self._external = np.zeros(3)
        self._limbs.start()
        self._pushes.clear()
        if self.compliance is not None:
            self.limp &= not self.compliance.felled
            self._lay = self.limp
            self.compliance.start()
        self._place(*self._target)

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push a part of the body from outside for some time.

        Args:
            part: The joint that the part ends at.
            force: The force at the part's center of mass [N], world frame, shape (3,).
            seconds: How long from now on.

        Raises:
            InputError: There is no such joint, no such force, or no time.
        """
        body = int(self._bodies[self.body.skeleton.index(part)])
        pushed = as_numbers(force, "the force of a push [N]", (3,), finite=True)
        lasting = as_number(seconds, "the time of a push")
        if not 0.0 <= lasting < np.inf:
            raise InputError(f"a push takes {lasting:g} s; give 0 or more")
        self._pushes.append((body, to_mujoco(pushed.astype(float)), lasting))

    @property
    def limp(self) -> bool:
        """Whether nothing pulls the character, so that it falls; can be set."""
        return bool(self.model.opt.disableactuator & (1 << PULLS))

    @limp.setter
    def limp(self, value: bool) -> None:
        bit = 1 << PULLS
        held = self.model.opt.disableactuator & ~bit
        self.model.opt.disableactuator = held | (bit if value else 0)

    def step(
        self,
        positions: Array,
        rotations: Array,
        dt: float,
        *,
        acceleration: Array | None = None,
        stands: Flags | None = None,
    ) -> bool:
        """Advance by dt [s] towards a target; return False if it had to be reset.

        The posture is then in ``self.rotations`` and ``self.root``.

        Args:
            positions: The target's joint positions.
            rotations: The target's rotations.
            dt: Time since the last step [s].
            acceleration: Of the targets [m/s^2], shape (J, 3); by default from the
                last two steps, half a frame late.
            stands: Whether each foot (left, right) bears weight, shape (2,); by
                default none does and the pulls carry the body.

        Raises:
            InputError: The target is not finite, or no time passes.
        """
        _check_target(positions, rotations)
        if not 0.0 < dt < np.inf:
            raise InputError(
                f"a step takes {dt:g} s; give the time since the last one, more than 0"
            )
        if (gives := self.compliance) is not None:
            positions, rotations = self._give_way(gives, positions, rotations, dt)
        after_p, after_q = to_mujoco(positions), to_mujoco(rotations)
        before_p, before_q = self._target
        flipped = np.vecdot(before_q, after_q) < 0.0
        after_q[flipped] *= -1.0
        velocity = (after_p - before_p) / dt
        if acceleration is None:
            gained = (velocity - self._velocity) / dt
        else:
            gained = to_mujoco(acceleration)
            gained = gained if gives is None else gained + to_mujoco(gives.gained)
        self._target, self._velocity = (after_p, after_q), velocity
        needed = self._masses * (gained + _UP * GRAVITY)
        carries = not self.limp
        if gives is not None:
            needed, carries = needed * gives.hold, gives.upright and carries
        self.data.xfrc_applied[self._bodies] = 0.0
        self._bear(after_p, needed.sum(axis=0), stands if carries else None, dt)
        for part, force, left in self._pushes:
            # What is left may be shorter than the frame: the impulse is what was asked.
            self.data.xfrc_applied[part, :3] += force * min(left / dt, 1.0)
        pushed = self.data.xfrc_applied[self._bodies, :3].sum(axis=0)
        pushed[2] += self._pressure
        self._pushes = [(p, f, left - dt) for p, f, left in self._pushes if left > dt]
        n, nu = after_p.size, len(self._stiffness)
        # In the segment's own frame, as the torques' axes are.
        turning = rotation_vector(multiply(inverse(before_q), after_q)) / dt
        ctrl, data, began = self.data.ctrl, self.data, self.data.time
        before = data.qpos.copy(), data.qvel.copy()
        ctrl[n:nu] = self._damping[n:] * np.vecdot(
            turning[self._turned], self._turn_axes
        )
        forward = self._damping[:n] * velocity.ravel() + needed.ravel()
        if self._props.any():
            ctrl[self._grips] = float(self._holds() and not self.limp)
        updates, substeps = steps_in(dt)
        self.model.opt.timestep = dt / (updates * substeps)
        for k in range(updates):
            # Midway between the first and the last step of this update: the engine
            # compares the target with the state at a step's beginning.
            share = (k + 0.5 - 0.5 / substeps) / updates
            point = before_p + share * (after_p - before_p)
            ctrl[:n] = self._stiffness[:n] * point.ravel() + forward
            # The engine makes them unit quaternions.
            data.mocap_quat[self._mocap] = before_q + share * (after_q - before_q)
            for _ in range(substeps):
                mujoco.mj_step(self.model, data)
                self._momentum.add(data)
                if gives is not None and self._props.any():
                    gives.feel(self.model, data, self.parts, self._props)
        self._external = self._momentum.beyond(data, pushed)
        if self._astray(after_p, began) or self._stuck(dt):
            mujoco.mj_resetData(self.model, data)
            data.qpos[:], data.qvel[:] = before  # of what is around it
            self._place(after_p, after_q)
            self._momentum.start()
            self._external[:] = 0.0
            return False
        self._raise()
        return True

    @property
    def _yields(self) -> bool:
        """Whether it need not be where its target is: let go, felled, or rising."""
        return self.limp or not (self.compliance is None or self.compliance.upright)

    def _give_way(
        self, gives: Compliance, positions: Array, rotations: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the target as blows have changed it, and scale the pulls."""
        for part, force, left in self._pushes:
            gives.hit(self.parts[part], from_mujoco(force) * min(left, dt))
        if self.limp and gives.lies(dt, float(np.linalg.norm(self.data.qvel[:3]))):
            self.limp = False
        if self._lay and not self.limp:
            there = positions[self.body.skeleton.root]
            gives.get_up(self.root, self.rotations, there)
            self._target = self.data.site_xpos[self._sites], to_mujoco(self.rotations)
            self._velocity = np.zeros_like(positions)
        if not self.limp:
            self.limp = gives.fall(dt)
        self._lay = self.limp
        share = gives.strength
        share = np.concatenate([share.repeat(3), share[self._turned]])
        stiffness, damping = self._gains
        self._stiffness, self._damping = stiffness * share**2, damping * share
        self.model.actuator_biasprm[: len(share), 1] = -self._stiffness
        self.model.actuator_biasprm[: len(share), 2] = -self._damping
        self.model.dof_damping[:] = self._resists * (TENSION if gives.felled else 1.0)
        return gives.target(positions, rotations, dt)

    def _holds(self) -> bool:
        """Tell whether both hands touch the same prop and should stay on it."""
        wanted, there = (
            float(np.linalg.norm(points[0] - points[1]))
            for points in (
                self._target[0][self._palms],
                self.data.site_xpos[self._sites[self._palms]],
            )
        )
        if wanted > there + _LETS_GO:
            return False
        pairs = self.model.geom_bodyid[self.data.contact.geom]
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        pairs = pairs[self._props[pairs[:, 1]]]
        left, right = (set(pairs[pairs[:, 0] == hand, 1]) for hand in self._hands)
        return bool(left & right)

    def _bear(
        self, target: Array, needed: Array, stands: Flags | None, dt: float
    ) -> None:
        """Let standing feet press on the floor with what moves and carries the body.

        Muscles pull between the body and the feet, so the weight that the pulls give to
        the body the feet take from the floor: only the floor carries. How much each
        foot bears depends on where the center of mass is.
        """
        wanted = np.zeros(2)
        if stands is not None and stands.all():
            left, right = 0.5 * target[self._feet, :2].sum(axis=1)
            apart = left - right
            share = (self._shares @ target[:, :2] - right) @ apart
            share = min(max(float(share / max(apart @ apart, 1e-6)), 0.0), 1.0)
            wanted[:] = share, 1.0 - share
        elif stands is not None:
            wanted[:] = stands
        most = dt / _LOADING_TIME
        self._load += np.minimum(np.maximum(wanted - self._load, -most), most)
        self._load[wanted == 0.0] = 0.0
        upward = min(max(float(needed[2]), 0.0), _HARDEST_STEP * self._weight)
        self._pressure = float(self._load.sum()) * upward
        self.data.xfrc_applied[self._soles, 2] = -self._load * upward

    def _astray(self, target: Array, before: float) -> bool:
        """Tell whether the character spins out of control or left its target."""
        # The engine begins anew at time 0 when its numbers run away.
        if not self.data.time > before or not np.abs(self.data.qvel).max() < _FASTEST:
            return True
        if self._yields:
            return False
        away = np.abs(self.data.site_xpos[self._sites] - target).max()
        return not away < LOST  # also true for NaN

    def _stuck(self, dt: float) -> bool:
        """Tell whether a limb is stuck, unless it may hang or was pushed away."""
        if self._yields or self._pushes:
            self._limbs.start()
            return False
        there = self.data.site_xpos[self._sites], self.data.xquat[self._bodies]
        return self._limbs.step(there, self._target, dt)

    def _place(self, positions: Array, rotations: Array) -> None:
        bones, qpos = self.body.skeleton, self.data.qpos
        qpos[:3], qpos[3:7] = positions[bones.root], rotations[bones.root]
        above = inverse(rotations[bones.segment_parents])
        relative = multiply(above, rotations[bones.segments])
        qpos[self._balls[:, None] + np.arange(4)] = relative
        self.data.qvel[: 3 * len(self._balls) + 6] = 0.0
        self.data.mocap_quat[self._mocap] = rotations
        mujoco.mj_kinematics(self.model, self.data)
        self._raise()

    def _raise(self) -> None:
        """Raise the character as a whole where it was thrown into the floor."""
        depth = sunk(self.data.site_xpos[self._sites, 2], self._clearance)
        if depth > 0.0:
            self.data.qpos[2] += depth
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
    def positions(self) -> Array:
        """Joint positions of the present posture [m], world frame, shape (J, 3)."""
        return from_mujoco(self.data.site_xpos[self._sites])

    @property
    def contacts(self) -> int:
        """Number of points in which the character touches itself or anything else."""
        return int(self._own[self.data.contact.geom].any(axis=1).sum())

    @property
    def external_force(self) -> float:
        """Mean force over the last step that only the pulls explain [body weights].

        The magnitude of what the body gained beyond what gravity, floor, things and
        pushes gave: what no person could do by muscles. 0 where nothing pulls, and
        where the character was put back.
        """
        if self.limp:
            return 0.0
        return float(np.linalg.norm(self._external) / self._weight)

    @property
    def tracking_error(self) -> float:
        """Mean distance of the joints from their targets [m]."""
        away = self.data.site_xpos[self._sites] - self._target[0]
        return float(np.sqrt(np.vecdot(away, away)).sum() / len(away))
