"""The character in MuJoCo's world, pulled to one target posture after another.

MuJoCo takes the place of the papers' ODE (Shum 2013, section VII): bounded PD forces
pull every joint to its target while the engine enforces segment lengths, ball joints,
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
from kinefilter.characters.rotations import IDENTITY
from kinefilter.characters.tracking import GameTracking, RagdollTracking
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.floor import clearances, floor_penetration
from kinefilter.scenes import load_scene

from .compliance import FALLEN_DAMPING, Compliance, relative_rotations
from .grasp import Grasp
from .holdable import add_ties
from .momentum import Momentum
from .moves import Move, MovePlanner
from .stuck_limbs import StuckLimbs

_UPDATE = 1.0 / 60.0  # s at most between two updates of the actuators' targets
_SUBSTEP = 1.0 / 240.0
"""Longest simulation step [s]: omega * dt = 0.25 at the default tracking. At 1/120 one
in six recorded takes of punches and kicks diverged somewhere."""
_LOST = 3.0
"""Distance [m] of a joint from its target that means divergence: more than the longest
jump of a tracker that the bounded forces are still catching up with."""
_TOP_SPEED = 1e3  # rad/s or m/s: no part of a body is ever that fast
_LOADING_TIME = 0.2  # s from a foot's first contact to its bearing the body
_REACTION_TIME = 0.02  # s in which feet press as hard as the pulls carry. A guess.
_HARDEST_STEP = 2.0  # body weights that feet press with. A guess: running, landing


def steps_in(dt: float) -> tuple[int, int]:
    """Return how many updates are in a frame of ``dt`` [s], and steps in an update."""
    updates = max(1, int(np.ceil(dt / _UPDATE - 1e-3)))
    return updates, max(1, int(np.ceil(dt / (updates * _SUBSTEP) - 1e-3)))


def check_target(positions: Array, rotations: Array) -> None:
    """Raise an InputError if a target, or one of several, is not finite."""
    # A single NaN would spoil every later step.
    if not (np.isfinite(positions).all() and np.isfinite(rotations).all()):
        raise InputError("the target is not finite; correct the frame or skip it")


class PulledCharacter:
    """The humanoid of one body, stepped from one target posture to the next.

    It stands in T-pose at the origin until ``start`` puts it elsewhere. Targets are
    joint positions [m], shape (J, 3), and segment rotations, wxyz, (J, 4), in the world
    frame. The scene is one of SCENES or an MJCF file, by default a floor; ``extend`` is
    called to add to it before it is compiled. Raises InputError as ``load_scene``.
    """

    def __init__(
        self,
        body: Body,
        tracking: Tracking | None = None,
        *,
        scene: str | Path | None = None,
        extend: Callable[[mujoco.MjSpec], object] = lambda _: None,
    ) -> None:
        self.body, joints = body, body.skeleton.joints
        if scene is None:
            spec = build_humanoid(body, tracking)
            # Finding the parts that do not touch each other costs 3 % and finds one.
            spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        else:
            spec = load_scene(scene, body, tracking=tracking)
            add_ties(spec)
        extend(spec)
        self.model = model = spec.compile()
        self.data = mujoco.MjData(model)
        self._sites = np.array([model.site(name).id for name in joints])
        self._bodies = np.array([model.body(name).id for name in joints])
        root = int(self._bodies[body.skeleton.root])
        ends = [model.joint(joints[j]) for j in body.skeleton.segments]
        self._balls = np.array([ball.qposadr[0] for ball in ends])
        # For each body of the model the joint at its end, -1 if not the character's.
        self.joint_of = np.full(model.nbody, -1)
        self.joint_of[self._bodies] = np.arange(len(joints))
        # The character's actuators come first: forces, then torques, of which the first
        # three are the root's, then one per segment.
        count = int(np.sum(model.actuator_group == PULLS))
        bias = model.actuator_biasprm[:count]
        self._stiffness, self._damping = self._gains = -bias[:, 1], -bias[:, 2]
        torques = range(3 * len(joints), count)
        turned = [model.actuator(i).name.split(":")[1] for i in torques]
        self._turned = np.array([joints.index(name) for name in turned])
        self._move = MovePlanner(body, self._turned, model.actuator_gear[torques, 3:])
        targets = [model.body(f"target:{name}").id for name in joints]
        self._mocap = model.body_mocapid[targets]
        self._palms = body.skeleton.sides("Hand")
        free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        self._props = np.isin(model.body_rootid, free[free != root])
        self._movable = bool(self._props.any())
        self.grasp = Grasp(model, self.data, body)
        self._weight = float(body.mass * GRAVITY)
        self._momentum = Momentum(self.data, self._sites, joint_masses(body), root)
        self._clearance, self._limbs = clearances(body), StuckLimbs(body)
        self._soles = self._bodies[ankles_and_toes(body.skeleton)[1]]
        self._joint_damping = model.dof_damping.copy()
        self.compliance = None
        if isinstance(tracking, GameTracking):
            self.compliance = Compliance(body, tracking)
        self.limp = isinstance(tracking, RagdollTracking)
        """Whether nothing pulls the character, so that it falls; can be set."""
        self._disabled = model.opt.disableactuator
        if mujoco.get_mju_user_warning() is None:
            # The engine's own handler writes a log file into the working directory;
            # the trace reports diverging steps anyway.
            mujoco.set_mju_user_warning(lambda _: None)
        self.start(body.rest_positions, np.tile(IDENTITY, (len(joints), 1)))

    def start(
        self, positions: Array, rotations: Array, *, reset_props: bool = True
    ) -> None:
        """Put the character at rest onto a target; raises InputError if it has NaN.

        With ``reset_props`` props return to where the scene has them, else they stop.
        """
        check_target(positions, rotations)
        there = self.data.qpos.copy()
        mujoco.mj_resetData(self.model, self.data)
        if not reset_props:
            self.data.qpos[:] = there
        self._target = (to_mujoco(positions), to_mujoco(rotations))
        self._velocity = np.zeros_like(self._target[0])
        self._load, self._pressing = np.zeros(2), np.zeros(2)
        self._carried = self._weight
        self._momentum.start()
        self._external = np.zeros(3)
        self._limbs.start()
        self.grasp.start(props_stay=not reset_props)
        self._pushes: list[tuple[int, Array, float]] = []
        if self.compliance is not None:
            self.limp &= not self.compliance.fallen
            self._was_limp = self.limp
            self.compliance.start()
        self._place(*self._target)

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push the part of the body that ends at a joint for the next seconds.

        The force [N], world frame, shape (3,), acts on the part's center of mass.
        Raises InputError if there is no such joint, or force or time is not valid.
        """
        body = int(self._bodies[self.body.skeleton.index(part)])
        pushed = as_numbers(force, "the force of a push [N]", (3,), finite=True)
        lasting = as_number(seconds, "the duration of a push [s]")
        if not 0.0 <= lasting < np.inf:
            raise InputError(f"a push lasts {lasting:g} s; give 0 or more, and finite")
        self._pushes.append((body, to_mujoco(pushed.astype(float)), lasting))

    def step(
        self,
        positions: Array,
        rotations: Array,
        dt: float,
        *,
        acceleration: Array | None = None,
        stands: Flags | None = None,
        seen: Flags | None = None,
    ) -> bool:
        """Advance by dt [s] towards a target; return False if it had to be reset.

        Afterwards ``positions``, ``rotations`` and ``root`` are those of the new pose.
        The acceleration of the target [m/s^2], shape (J, 3), is by default that of the
        last two steps, half a frame late. ``stands`` says whether each foot (left,
        right) bears weight; by default none does, and the pulls carry the body. What
        is held stays in hands that the sensor has not ``seen``, shape (2,).
        Raises InputError if the target is not finite or no time passes.
        """
        check_target(positions, rotations)
        if not 0.0 < dt < np.inf:
            raise InputError(f"dt is {dt:g} s; give the time since the last step, > 0")
        if (gives := self.compliance) is not None:
            positions, rotations = self._give_way(gives, positions, rotations, dt)
        if self._yields:
            self.grasp.start()
        else:
            positions, rotations = self.grasp.target(positions, rotations, dt, seen)
        before, after = self._target, (to_mujoco(positions), to_mujoco(rotations))
        velocity = (after[0] - before[0]) / dt
        if acceleration is None:
            gained = (velocity - self._velocity) / dt
        else:
            gained = to_mujoco(acceleration)
            gained = gained if gives is None else gained + to_mujoco(gives.acceleration)
        self._velocity = velocity
        share = 1.0 if gives is None else gives.recovered
        move = self._move(before, after, gained, dt, self._damping, share)
        return self._follow(move, stands)

    def _follow(self, move: Move, stands: Flags | None) -> bool:
        """Pull the character through a move; return False if it had to be reset."""
        gives, model, data, dt = self.compliance, self.model, self.data, move.duration
        began, before = data.time, (data.qpos.copy(), data.qvel.copy())
        (before_p, before_q), (after_p, after_q) = move.before, move.after
        self._target = move.after
        carries = not self.limp and (gives is None or gives.follows)
        data.xfrc_applied[self._bodies] = 0.0
        self._load_feet(move, stands if carries else None)
        self._pressing = np.zeros(2)
        pushed = np.zeros(3)
        for part, force, left in self._pushes:
            # A push may end within the frame: scaled, it gives the impulse asked for.
            given = force * min(left / dt, 1.0)
            data.xfrc_applied[part, :3] += given
            pushed += given
        self._pushes = [(p, f, left - dt) for p, f, left in self._pushes if left > dt]
        n, ctrl, quats = after_p.size, data.ctrl, data.mocap_quat
        ctrl[n : len(move.forward)] = move.forward[n:]
        stiffness, forward = self._stiffness[:n], move.forward[:n]
        if (held := self.grasp.weight) > 0.0:
            forward = forward.copy()
            forward.reshape(-1, 3)[self._palms, 2] += 0.5 * held
        updates, substeps = steps_in(dt)
        model.opt.timestep = dt / (updates * substeps)
        model.opt.disableactuator = self._disabled | (self.limp << PULLS)
        for k in range(updates):
            # Midway between the first and the last step of this update, as the engine
            # compares the target with the state at the beginning of a step.
            share = (k + 0.5 - 0.5 / substeps) / updates
            point = before_p + share * (after_p - before_p)
            ctrl[:n] = stiffness * point.ravel() + forward
            # The engine normalizes these quaternions.
            quats[self._mocap] = before_q + share * (after_q - before_q)
            for _ in range(substeps):
                self._press_feet(model.opt.timestep)
                mujoco.mj_step(model, data)
                self._momentum.add()
                if gives is not None and self._movable:
                    gives.hit_by_props(model, data, self.joint_of, self._props)
        self._external = self._momentum.unexplained(pushed)
        if self._diverged(after_p, began) or self._stuck(dt):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = before  # of the props
            self._place(after_p, after_q)
            self.grasp.drop()
            self._momentum.start()
            self._external[:] = 0.0
            return False
        self._raise()
        return True

    @property
    def _yields(self) -> bool:
        """Whether it may be away from its target: limp, fallen or returning."""
        return self.limp or not (self.compliance is None or self.compliance.follows)

    def _give_way(
        self, gives: Compliance, positions: Array, rotations: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the target as changed by hits, and scale the pulls."""
        for part, force, left in self._pushes:
            gives.hit(self.joint_of[part], from_mujoco(force) * min(left, dt))
        if self.limp and gives.can_rise(dt, float(np.linalg.norm(self.data.qvel[:3]))):
            self.limp = False
        if self._was_limp and not self.limp:
            gives.rise(self.root, self.rotations, positions[self.body.skeleton.root])
            self._target = self.data.site_xpos[self._sites], to_mujoco(self.rotations)
            self._velocity = np.zeros_like(positions)
        if not self.limp:
            self.limp = gives.take_hits(dt)
        self._was_limp = self.limp
        share = gives.frequencies
        share = np.concatenate([share.repeat(3), share[self._turned]])
        stiffness, damping = self._gains
        self._stiffness, self._damping = stiffness * share**2, damping * share
        self.model.actuator_biasprm[: len(share), 1] = -self._stiffness
        self.model.actuator_biasprm[: len(share), 2] = -self._damping
        scale = FALLEN_DAMPING if gives.fallen else 1.0
        self.model.dof_damping[:] = self._joint_damping * scale
        return gives.target(positions, rotations, dt)

    def _load_feet(self, move: Move, stands: Flags | None) -> None:
        """Shift the body's weight toward the feet that are to bear it."""
        wanted = np.zeros(2) if stands is None else stands.astype(float)
        if wanted.all():
            wanted = np.array([move.left_share, 1.0 - move.left_share])
        most = move.duration / _LOADING_TIME
        loads = self._load + np.clip(wanted - self._load, -most, most)
        self._load = np.where(wanted > 0.0, loads, 0.0)

    def _press_feet(self, dt: float) -> None:
        """Press loaded feet on the floor with what the pulls carry of the body.

        Muscles act between the body and the feet, so that only the floor carries it.
        """
        share = min(dt / _REACTION_TIME, 1.0)
        self._carried += share * (self._momentum.lifting - self._carried)
        most = _HARDEST_STEP * self._weight
        pressing = self._load * min(max(self._carried, 0.0), most)
        self.data.xfrc_applied[self._soles, 2] -= pressing - self._pressing
        self._pressing = pressing

    def _diverged(self, target: Array, before: float) -> bool:
        """Return True if the character spins out of control or lost its target."""
        # The engine restarts at time 0 when its numbers overflow.
        if not self.data.time > before or not np.abs(self.data.qvel).max() < _TOP_SPEED:
            return True
        away = np.abs(self.data.site_xpos[self._sites] - target).max()
        return not (self._yields or away < _LOST)  # also True for NaN

    def _stuck(self, dt: float) -> bool:
        """Return True if a limb is stuck, unless it may hang or was pushed away."""
        if self._yields or self._pushes:
            self._limbs.start()
            return False
        pose = self.data.site_xpos[self._sites], self.data.xquat[self._bodies]
        return self._limbs.step(pose, self._target, dt)

    def _place(self, positions: Array, rotations: Array) -> None:
        skeleton, qpos = self.body.skeleton, self.data.qpos
        qpos[:3], qpos[3:7] = positions[skeleton.root], rotations[skeleton.root]
        relative = relative_rotations(rotations, skeleton)[skeleton.segments]
        qpos[self._balls[:, None] + np.arange(4)] = relative
        self.data.qvel[: 3 * len(self._balls) + 6] = 0.0
        self.data.mocap_quat[self._mocap] = rotations
        mujoco.mj_kinematics(self.model, self.data)
        self._raise()

    def _raise(self) -> None:
        """Raise the whole character if it was thrown into the floor."""
        depth = floor_penetration(self.data.site_xpos[self._sites, 2], self._clearance)
        if depth > 0.0:
            self.data.qpos[2] += depth
            mujoco.mj_kinematics(self.model, self.data)

    @property
    def rotations(self) -> Array:
        """World segment rotations of the current pose, wxyz, shape (J, 4)."""
        return from_mujoco(self.data.xquat[self._bodies])

    @property
    def root(self) -> Array:
        """Position of the root joint [m], world frame, shape (3,)."""
        return from_mujoco(self.data.qpos[:3])

    @property
    def positions(self) -> Array:
        """Joint positions of the current pose [m], world frame, shape (J, 3)."""
        return from_mujoco(self.data.site_xpos[self._sites])

    @property
    def external_force(self) -> float:
        """Mean force over the last step that only the pulls explain [body weights].

        It changed the momentum beyond what gravity, floor, props and pushes did, which
        no muscle could. 0 where nothing pulls, and where the character was reset.
        """
        force = float(np.linalg.norm(self._external) / self._weight)
        return 0.0 if self.limp else force
