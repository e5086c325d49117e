"""How a character gives way to hits, falls down, and returns to the performer.

A hit makes the body sway over its feet: a critically damped oscillator takes up the
hit's momentum with the mass that sways, and shifts the target, more the higher a joint
is. Meanwhile the pulls soften where the body was hit. A hit that would throw the whole
body knocks it down instead: nothing pulls it until it lies still. Then the target
starts where the body lies, takes on the performer's posture, and returns to them.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from kinefilter.characters import Body, Skeleton, positions_from_rotations
from kinefilter.characters.anthropometry import joint_masses
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.humanoid import from_mujoco, to_mujoco
from kinefilter.characters.rotations import (
    about_x,
    about_y,
    inverse,
    multiply,
    rotation_vector,
    slerp,
)
from kinefilter.characters.tracking import GameTracking
from kinefilter.retarget.limbs import smooth_step

FALLEN_DAMPING = 8.0
"""Joint damping of a fallen body, relative to a limp one. A guess: at 1, bodies that
are thrown hard spin out of control."""
_HORIZONTAL = np.array([1.0, 0.0, 1.0])
_MEMORY = 0.4  # s in which hits add up to one. A guess.
_SOFTENING_SPEED = 0.5  # m/s of the whole body at which a hit softens fully. A guess.
_HARDENING_TIME = 0.5  # s in which the pulls recover where the body was hit. A guess.
_SPREAD = 0.6  # of the softening that reaches the next joint. A guess.
_GRASP_TIME = 0.3  # s in which the pulls of a lying body recover. A guess.
_STILL, _LONGEST = 0.5, 4.0  # m/s below which, or s after which, a fallen body rises
_BENT = np.radians(30.0)  # of elbows and knees of a limp body. A guess.
# N m/rad, of elbows and knees: of five pairs, chosen on twelve falls. In 16 others,
# elbows bend backward by 8 degrees at worst, on average (59 without springs).
_SPRINGS = np.array([30.0, 30.0, 60.0, 60.0])
_RETURN_RATE = 4.0  # 1/s, of the distance that is left, at the end. A guess.


class Compliance:
    """Effect of hits on the targets and the pulls of one body, y up.

    ``fallen``: a hit knocked the body down, so that nothing is to pull it;
    ``recovered``: the share of the pulls that a rising body has back, otherwise 1;
    ``acceleration`` of the target by the sway [m/s^2], shape (J, 3).
    """

    def __init__(self, body: Body, tracking: GameTracking) -> None:
        from scipy.sparse.csgraph import shortest_path  # takes long to load

        self._body, self._tracking = body, tracking
        heights = body.rest_positions[:, 1]
        self._sways = np.clip(heights / heights[body.skeleton.girdle], 0.0, 1.0)
        self._swaying = float(joint_masses(body) @ self._sways**2)
        edges = np.zeros((len(heights), len(heights)))
        edges[body.skeleton.segments, body.skeleton.segment_parents] = 1.0
        self._joints_apart = shortest_path(edges, directed=False)
        self._soft = tracking.hit_frequency / tracking.natural_frequency
        self.start()

    def start(self) -> None:
        """Reset the state: no hit, and the body follows."""
        shape = (len(self._sways), 3)
        self._impulses, self.acceleration = np.zeros(shape), np.zeros(shape)
        self._blow, self._sway, self._speed = np.zeros((3, 3))
        self._softness = np.zeros(len(self._sways))
        self.fallen, self.recovered = False, 1.0
        self._lying: tuple[Array, Array] | None = None
        self._offset, self._since = np.zeros(3), 0.0

    @property
    def doing(self) -> str:
        """What the character does, in words."""
        if self._lying is None:
            return "fell" if self.fallen else "follows"
        return "gets up" if self._since < self._tracking.rising else "returns"

    @property
    def follows(self) -> bool:
        """Whether the body follows the performer, neither fallen nor returning."""
        return not self.fallen and self._lying is None

    @property
    def frequencies(self) -> Array:
        """Natural frequency of each joint's pull, relative to its usual one, (J,)."""
        return self.recovered * (1.0 - (1.0 - self._soft) * self._softness)

    def hit(self, joint: int, impulse: Array) -> None:
        """Add an impulse [N s], shape (3,), to the segment that ends at a joint."""
        self._impulses[joint] += impulse

    def hit_by_props(self, data: mujoco.MjData, joints: Indices, props: Flags) -> None:
        """Add the impulses that props gave the body in the last step.

        For each body of the model, ``joints`` has the joint at which that segment ends,
        -1 for others, and ``props`` is True if it is a prop that can move.
        """
        model, force = data.model, np.empty(6)
        bodies = model.geom_bodyid[data.contact.geom]
        hit = (joints[bodies] >= 0) & props[bodies[:, ::-1]]
        for k, segment in np.argwhere(hit):
            mujoco.mj_contactForce(model, data, k, force)
            world_force = force[:3] @ data.contact.frame[k].reshape(3, 3)
            impulse = (-1.0, 1.0)[segment] * model.opt.timestep * world_force
            self.hit(joints[bodies[k, segment]], from_mujoco(impulse))

    def forget_hits(self) -> None:
        """Forget the hits that ``take_hits`` has not taken yet."""
        self._impulses[:] = 0.0

    def take_hits(self, dt: float) -> bool:
        """Take the hits of the last ``dt`` [s]; return True if they knock it down."""
        impulses, tracking = self._impulses * _HORIZONTAL, self._tracking
        self._impulses[:] = 0.0
        self._blow = self._blow * np.exp(-dt / _MEMORY) + impulses.sum(axis=0)
        speed = float(np.linalg.norm(self._blow)) / self._body.mass
        if speed > tracking.felling_speed:
            self.start()
            self.fallen = True
            return True
        w, before = tracking.sway_frequency, self._speed
        rest = self._sways @ impulses / (dt * self._swaying * w**2)
        off, self._speed = damped(self._sway - rest, before, w, dt)
        self._sway = rest + off
        self.acceleration = self._sways[:, None] * (self._speed - before) / dt
        self._softness *= np.exp(-dt / _HARDENING_TIME)
        if impulses.any():
            joint = np.argmax(np.vecdot(impulses, impulses))
            softness = min(speed / _SOFTENING_SPEED, 1.0)
            softness = softness * _SPREAD ** self._joints_apart[joint]
            self._softness = np.maximum(self._softness, softness)
        return False

    def can_rise(self, dt: float, speed: float) -> bool:
        """Return True if a body that fell is to get up; its hips have a speed [m/s]."""
        self._since += dt
        still = speed < _STILL and self._since > self._tracking.lying
        return self.fallen and (still or self._since > _LONGEST)

    def rise(self, root: Array, rotations: Array, performer: Array) -> None:
        """Start to get up from a pose; the performer's root is at a place [m], (3,)."""
        self.start()
        self._lying = root, relative_rotations(rotations, self._body.skeleton)
        self._offset, self.recovered = (root - performer) * _HORIZONTAL, 0.0

    def target(
        self, positions: Array, rotations: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return a target (J, 3) and (J, 4), ``dt`` [s] later, changed by the hits."""
        if self._lying is not None:
            self._since += dt
            self.recovered = float(smooth_step(self._since / _GRASP_TIME))
            share = smooth_step(self._since / self._tracking.rising)
            root, relative = self._lying
            goal = positions[self._body.skeleton.root] + self._offset
            own = relative_rotations(rotations, self._body.skeleton)
            rotations = self._between(relative, own, share)
            root = root + share * (goal - root)
            positions = positions_from_rotations(rotations, root, self._body)
            distance = float(np.linalg.norm(self._offset))
            if share == 1.0 and distance < 1e-3:
                self._lying = None
            elif share == 1.0:
                eased = smooth_step(self._since - self._tracking.rising)
                pace = float(eased) * self._tracking.return_speed
                pace = min(_RETURN_RATE * distance, pace)
                self._offset *= 1.0 - pace * dt / distance
        return positions + self._sways[:, None] * self._sway, rotations

    def _between(self, one: Array, other: Array, share: Array) -> Array:
        """Return world rotations between two sets of relative ones."""
        from scipy.spatial.transform import Rotation

        skeleton, world = self._body.skeleton, slerp(one, other, share)
        # The shortest arc may leave a joint's range; a line of rotation vectors stays.
        line = (1.0 - share) * rotation_vector(one) + share * rotation_vector(other)
        relative = Rotation.from_rotvec(line).as_quat(scalar_first=True)
        for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
            world[j] = multiply(world[p], relative[j])
        return world


class LimpJoints:
    """Springs of a limp body's elbows and knees, which hold them a little bent.

    As joints of the character are balls, those of a body that falls would otherwise
    bend backward and sideways. Names of the model's joints are in the skeleton's order.
    """

    def __init__(
        self, model: mujoco.MjModel, skeleton: Skeleton, names: Sequence[str]
    ) -> None:
        self._model, ends = model, (*skeleton.sides("Wrist"), *skeleton.sides("Ankle"))
        joints = [model.joint(names[end]) for end in ends]
        self._joints = [joint.id for joint in joints]
        # In the T-pose, elbows bend about the vertical and knees about the sides.
        bends = about_y(-_BENT), about_y(_BENT), about_x(_BENT), about_x(_BENT)
        for joint, bend in zip(joints, bends, strict=True):
            model.qpos_spring[joint.qposadr[0] :][:4] = to_mujoco(bend)

    def set(self, limp: bool) -> None:
        """Switch the springs on for a limp body, and off for one that is pulled."""
        self._model.jnt_stiffness[self._joints] = limp * _SPRINGS


def relative_rotations(rotations: Array, skeleton: Skeleton) -> Array:
    """Return rotations (J, 4) relative to the parents', the root's to the world."""
    relative, ends = rotations.copy(), skeleton.segments
    parents = inverse(rotations[skeleton.segment_parents])
    relative[ends] = multiply(parents, rotations[ends])
    return relative


def damped(
    off: Array, speed: Array, frequency: float, dt: float
) -> tuple[Array, Array]:
    """Return how far a critically damped spring is from rest, and its velocity.

    These are in m and m/s, ``dt`` [s] later; its natural frequency is in rad/s.
    """
    drift, decay = speed + frequency * off, np.exp(-frequency * dt)
    later = off + drift * dt
    return later * decay, (drift - frequency * later) * decay
