"""The character in MuJoCo's world, pulled to one target posture after another.

MuJoCo takes the place of the papers' ODE (Shum 2013, section VII): bounded PD forces
pull every joint to its target while the engine enforces segment lengths, ball joints,
gravity and the floor, so the result obeys them whatever the target does.
"""

from __future__ import annotations

from math import hypot
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body, InputError, Tracking
from kinefilter.characters.anthropometry import GRAVITY, joint_masses
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import (
    FLOOR_BIT,
    PULLS,
    from_mujoco,
    prefix_of,
    to_mujoco,
)
from kinefilter.characters.rotations import IDENTITY
from kinefilter.characters.tracking import GameTracking, RagdollTracking
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.floor import clearances, floor_penetration

from .compliance import FALLEN_DAMPING, Compliance, LimpJoints
from .grasp import Grasp
from .momentum import Momentum
from .moves import Coordinates, Move, MovePlanner, check_target
from .pushes import Pushes
from .seat import Seat
from .standing_feet import StandingFeet
from .stuck_limbs import StuckLimbs
from .world import World

_LOST = 3.0
"""Distance [m] of a joint from its target that means divergence: more than the longest
jump of a tracker that the bounded forces are still catching up with."""

_FASTEST = 5.0
"""Speed [m/s] of a joint above which a live first move is taken for a jump of the
tracker. Whoever then began as fast would be stopped only 6 cm behind it."""


class PulledCharacter:
    """The humanoid of one body, stepped from one target posture to the next.

    It stands in T-pose at the origin until ``start``. Targets are joint positions [m]
    (J, 3), and segment rotations, wxyz, (J, 4), in the world frame. It is alone in a
    world of its own, unless it is given one. Raises InputError as ``World``.
    """

    def __init__(
        self,
        body: Body,
        tracking: Tracking | None = None,
        *,
        scene: str | Path | None = None,
        world: World | None = None,
    ) -> None:
        self.body, joints = body, body.skeleton.joints
        if world is None:
            world = World([body], tracking, scene=scene)
        self.world, self.model, self.data = world, world.model, world.data
        model, prefix = self.model, prefix_of(len(world.characters))
        names = [f"{prefix}{name}" for name in joints]
        self._sites = np.array([model.site(name).id for name in names])
        self._bodies = np.array([model.body(name).id for name in names])
        self._root_joint = body.skeleton.root
        self.root_body = root = int(self._bodies[self._root_joint])
        self._coordinates = where = Coordinates(model, body.skeleton, names)
        self._root, self._speeds = where.root, where.speeds
        # For each body of the model the joint at its end, -1 if not the character's.
        self.joint_of = np.full(model.nbody, -1)
        self.joint_of[self._bodies] = np.arange(len(joints))
        # Forces, then torques: three of the root's, then one per segment.
        self.group = PULLS - world.add(self, where.places, where.speeds)
        pulls = np.flatnonzero(model.actuator_group == self.group)
        self._pulls = slice(int(pulls[0]), int(pulls[-1]) + 1)
        bias = model.actuator_biasprm[self._pulls]
        self._stiffness, damping = self._gains = -bias[:, 1], -bias[:, 2]
        torques = pulls[3 * len(joints) :]
        turned = [model.actuator(i).name.split(":")[-2] for i in torques]
        self._turned = np.array([joints.index(name) for name in turned])
        axes = model.actuator_gear[torques, 3:]
        self.planner = MovePlanner(body, self._turned, axes, damping)
        targets = [model.body(f"{prefix}target:{name}").mocapid[0] for name in joints]
        # Views of the engine's memory: reading an attribute makes a new one.
        self._turns = self.data.mocap_quat[targets[0] : targets[-1] + 1]
        self._ctrl = self.data.ctrl[self._pulls]
        self._palms = body.skeleton.sides("Hand")
        free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        # Other characters count as props, which can hit this one.
        self._props = np.isin(model.body_rootid, free[free != root])
        self._movable = bool(self._props.any())
        own = np.isin(model.geom_bodyid, self._bodies)
        self._geoms = np.flatnonzero(own)
        self._collisions = model.geom_contype[own], model.geom_conaffinity[own]
        self.is_part = own  # which geoms of the model are the character's
        self._is_other = ~own
        self._is_other[model.geom("floor").id] = False
        firm = self._stiffness[: 3 * len(joints) : 3]
        self.seat = Seat(self.data, body, self.joint_of, firm)
        self.grasp = Grasp(self.data, body, prefix)
        self._weight = float(body.mass * GRAVITY)
        masses = joint_masses(body)
        self.momentum = Momentum(self.data, self._sites, masses, root, self._pulls)
        self._clearance, self._limbs = clearances(body), StuckLimbs(body)
        soles = self._bodies[ankles_and_toes(body.skeleton)[1]]
        self.feet = StandingFeet(self.data, soles, self._weight)
        self._joint_damping = model.dof_damping[self._speeds].copy()
        self._limp_joints = LimpJoints(model, body.skeleton, names)
        self.compliance = None
        if isinstance(tracking, GameTracking):
            self.compliance = Compliance(body, tracking)
        # Whether nothing pulls the character, so that it falls; can be set.
        self.limp = isinstance(tracking, RagdollTracking)
        self.start(body.rest_positions, np.tile(IDENTITY, (len(joints), 1)))

    def start(
        self, positions: Array, rotations: Array, *, reset_props: bool = True
    ) -> None:
        """Put the character at rest onto a target; raises InputError if it has NaN.

        With ``reset_props`` props return to where the scene has them; otherwise they
        stop, unless others are in the world.
        """
        check_target(positions, rotations)
        self.world.reset(props=reset_props)
        self._target = (to_mujoco(positions), to_mujoco(rotations))
        self._velocity, self._external = np.zeros_like(self._target[0]), np.zeros(3)
        self.fastest_start = _FASTEST  # up to which the next move begins at its speed
        for part in (self.feet, self.momentum, self._limbs, self.seat):
            part.start()
        self.grasp.start(props_stay=not reset_props)
        self._pushes = Pushes()
        if self.compliance is not None:
            self.limp &= not self.compliance.fallen
            self._was_limp = self.limp
            self.compliance.start()
        self._place(*self._target)

    def take_over(self, other: PulledCharacter) -> None:
        """Go on from where one of the same body is in another world."""
        there, here = other._coordinates.places, self._coordinates.places
        self.data.qpos[here] = other.data.qpos[there]
        self.data.qvel[self._speeds] = other.data.qvel[other._speeds]
        mujoco.mj_kinematics(self.model, self.data)
        self._target, self._velocity = other._target, other._velocity
        self.fastest_start = other.fastest_start
        self._pushes, self.limp, self._limbs = other._pushes, other.limp, other._limbs
        if self.compliance is not None:
            self.compliance, self._was_limp = other.compliance, other._was_limp
        for part in ("grasp", "seat", "feet", "momentum"):
            getattr(self, part).take_over(getattr(other, part))

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push the part of the body that ends at a joint for the next seconds.

        The force [N], world frame, shape (3,), acts on the part's center of mass.
        Raises InputError if there is no such joint, or force or time is not valid.
        """
        self._pushes.add(self.body.skeleton.index(part), force, seconds)

    def step(
        self,
        positions: Array,
        rotations: Array,
        dt: float,
        *,
        stands: Flags | None = None,
        seen: Flags | None = None,
    ) -> bool:
        """Advance by dt [s] towards a target, as in ``plan``; False if it was reset.

        ``stands`` says whether each foot (left, right) bears weight; by default none
        does, and the pulls carry the body. In a world with others, call ``plan`` for
        each and then ``World.follow``.
        """
        move = self.plan(positions, rotations, dt, seen=seen)
        return bool(self.world.follow([move], [stands])[0])

    def plan(
        self,
        positions: Array,
        rotations: Array,
        dt: float,
        *,
        acceleration: Array | None = None,
        seen: Flags | None = None,
    ) -> Move:
        """Return the move to a target within dt [s], for ``World.follow``.

        The acceleration of the target [m/s^2] (J, 3) is by default that of the last two
        steps, half a frame late. What is held stays in hands that the sensor has not
        ``seen`` (2,). Raises InputError if the target is not finite or no time passes.
        """
        check_target(positions, rotations)
        if not 0.0 < dt < np.inf:
            raise InputError(f"dt is {dt:g} s; give the time since the last step, > 0")
        if (gives := self.compliance) is not None:
            positions, rotations = self._give_way(gives, positions, rotations, dt)
        if self._yields:
            self.grasp.start()
            self.seat.start()
        else:
            pulled, held = from_mujoco(self._external), self.grasp.held
            target = positions, rotations, dt, pulled, held
            positions, rotations = self.seat.target(*target)
            positions, rotations = self.grasp.target(positions, rotations, dt, seen)
        before, after = self._target, (to_mujoco(positions), to_mujoco(rotations))
        velocity = (after[0] - before[0]) / dt
        if acceleration is None:
            before_that = velocity if self.fastest_start else self._velocity
            gained = (velocity - before_that) / dt
        else:
            gained = to_mujoco(acceleration)
            gained = gained if gives is None else gained + to_mujoco(gives.acceleration)
        self._velocity = velocity
        share = 1.0 if gives is None else gives.recovered
        return self.planner(before, after, gained, dt, share)

    def begin(self, move: Move, stands: Flags | None) -> None:
        """Apply the forces of a move that do not change during it."""
        gives, data, dt = self.compliance, self.data, move.duration
        self._move, self._target = move, move.after
        self._limp_joints.set(self.limp)
        carries = not self.limp and (gives is None or gives.follows)
        if self.fastest_start > 0.0 and carries and move.speed < self.fastest_start:
            data.qvel[self._speeds] = self._coordinates.speeds_of(data.qpos, move)
            self.momentum.set_off(move.velocity)
        self.fastest_start = 0.0
        data.xfrc_applied[self._bodies] = 0.0
        self._pushed = self._pushes.apply(data, self._bodies, dt)
        self.feet.begin(move, stands if carries else None)
        self._on_trunk = data.xfrc_applied[self.root_body, :3].copy()
        self._returned = np.zeros(3)
        n = move.after[0].size
        self._forward, self._ctrl[n:] = move.forward[:n], move.forward[n:]
        if (loads := self.grasp.loads).any():
            self._forward = self._forward.copy()
            self._forward.reshape(-1, 3)[self._palms, 2] += loads

    def begin_again(self) -> None:
        """Forget what it felt since ``begin``, because the step is taken again."""
        self.momentum.forget()
        self._returned[:] = 0.0
        self.feet.begin_again()
        if self.compliance is not None:
            self.compliance.forget_hits()

    def aim(self, share: float) -> None:
        """Aim the pulls at the point that lies at a share of the move."""
        (before_p, before_q), (after_p, after_q) = self._move.before, self._move.after
        point, n = before_p + share * (after_p - before_p), after_p.size
        self._ctrl[:n] = self._stiffness[:n] * point.ravel() + self._forward
        # The engine normalizes these quaternions.
        self._turns[:] = before_q + share * (after_q - before_q)

    def press(self, timestep: float) -> None:
        """Apply the forces of a substep of some length [s]."""
        self.feet.press(timestep)
        if (force := self.grasp.press()) is not None:
            # The arm passes what the ball returns on to the trunk.
            trunk = self.data.xfrc_applied[self.root_body]
            trunk[:3] = self._on_trunk - force
            self._returned -= force

    def feel(self) -> None:
        """Note what the last substep did to the character."""
        self.momentum.add()
        self.feet.lifting = self.momentum.lifting
        if self.compliance is not None and self._movable:
            self.compliance.hit_by_props(self.data, self.joint_of, self._props)

    def end(self) -> None:
        """Evaluate the forces of the move."""
        pushed = self._pushed + self._returned / self.momentum.steps
        self._external = self.momentum.unexplained(pushed)

    def put_back(self) -> None:
        """Put the character at rest onto its target."""
        target = self._target
        self._move = self.planner(target, target, 0.0 * target[0], 1.0)
        self._place(*target)
        self.grasp.drop()
        self.momentum.start()
        self.feet.settle()
        self._external[:] = 0.0

    @property
    def keeps_target(self) -> bool:
        """Whether nothing changes its targets: no hits, props for hands, or seats."""
        changed = self.compliance is not None or self.grasp.props or self.seat.exists
        return not changed

    @property
    def _yields(self) -> bool:
        """Whether it may be away from its target: limp, fallen or returning."""
        return self.limp or not (self.compliance is None or self.compliance.follows)

    def _give_way(
        self, gives: Compliance, positions: Array, rotations: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the target as changed by hits, and scale the pulls."""
        for joint, impulse in self._pushes.impulses(dt):
            gives.hit(joint, from_mujoco(impulse))
        speed = float(np.linalg.norm(self.data.qvel[self._speeds][:3]))
        self.limp = self.limp and not gives.can_rise(dt, speed)
        if self._was_limp and not self.limp:
            gives.rise(self.root, self.rotations, positions[self._root_joint])
            self._target = self.data.site_xpos[self._sites], to_mujoco(self.rotations)
            self._velocity = np.zeros_like(positions)
        self._was_limp = self.limp = self.limp or gives.take_hits(dt)
        share = gives.frequencies
        share = np.concatenate([share.repeat(3), share[self._turned]])
        stiffness, damping = self._gains
        self._stiffness, self.planner.damping = stiffness * share**2, damping * share
        self.model.actuator_biasprm[self._pulls, 1] = -self._stiffness
        self.model.actuator_biasprm[self._pulls, 2] = -self.planner.damping
        scale = FALLEN_DAMPING if gives.fallen else 1.0
        self.model.dof_damping[self._speeds] = self._joint_damping * scale
        return gives.target(positions, rotations, dt)

    @property
    def is_lost(self) -> bool:
        """Whether it is too far from its target, or nowhere."""
        away = np.abs(self.data.site_xpos[self._sites] - self._target[0]).max()
        return not (self._yields or away < _LOST)  # also True for NaN

    def is_stuck(self, dt: float) -> bool:
        """Return True if a limb is stuck, unless it may hang or was pushed away.

        To be called once a step, after ``dt`` [s].
        """
        if self._yields or self._pushes:
            self._limbs.start()
            return False
        pose = self.data.site_xpos[self._sites], self.data.xquat[self._bodies]
        return self._limbs.step(pose, self._target, dt, self._is_blocked)

    def _is_blocked(self) -> bool:
        """Whether it touches anything but itself and the floor."""
        touching = self.data.contact.geom
        own, others = self.is_part[touching], self._is_other[touching]
        return bool((own & others[:, ::-1]).any())

    def _place(self, positions: Array, rotations: Array) -> None:
        self._coordinates.pose(self.data.qpos, positions, rotations)
        self.data.qvel[self._speeds] = 0.0
        self._turns[:] = rotations
        mujoco.mj_kinematics(self.model, self.data)
        self.rise_from_floor()

    def rise_from_floor(self) -> None:
        """Raise the whole character if it was thrown into the floor."""
        depth = floor_penetration(self.data.site_xpos[self._sites, 2], self._clearance)
        if depth > 0.0:
            self.data.qpos[self._root][2] += depth
            mujoco.mj_kinematics(self.model, self.data)

    def set_solid(self, solid: bool) -> None:
        """Have it touch others, itself and props, or else only the floor.

        Has no effect on a character that is alone in its world.
        """
        if len(self.world.characters) > 1:
            types, like = self._collisions
            bits = (types, like) if solid else (0, like & FLOOR_BIT)
            self.model.geom_contype[self._geoms] = bits[0]
            self.model.geom_conaffinity[self._geoms] = bits[1]

    @property
    def rotations(self) -> Array:
        """World segment rotations of the current pose, wxyz, shape (J, 4)."""
        return from_mujoco(self.data.xquat[self._bodies])

    @property
    def root(self) -> Array:
        """Position of the root joint [m], world frame, shape (3,)."""
        return from_mujoco(self.data.qpos[self._root][:3])

    @property
    def positions(self) -> Array:
        """Joint positions of the current pose [m], world frame, shape (J, 3)."""
        return from_mujoco(self.data.site_xpos[self._sites])

    @property
    def external_force(self) -> float:
        """Mean force over the last step that only the pulls explain [body weights].

        No muscle could exert it. 0 where nothing pulls, or the character was reset.
        """
        return 0.0 if self.limp else hypot(*self._external) / self._weight
