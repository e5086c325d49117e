"""How a character gives way to blows, falls, and comes back to the performer.

A blow sways the body over its feet: a critically damped oscillator of the mass that
moves with the sway, which takes up the blow's momentum, moves the target, the more the
higher a joint is. Where the body was hit the pulls soften meanwhile. A blow that would
throw the whole body fells it instead: nothing pulls it until it lies still. Then the
target begins where it lies, takes on the performer's posture, and goes back to them.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.transform import Rotation

from kinefilter.characters import Body, positions_from_rotations
from kinefilter.characters.anthropometry import joint_masses
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import inverse, multiply, rotation_vector, slerp
from kinefilter.characters.tracking import GameTracking
from kinefilter.retarget.stance import smooth_step

TENSION = 8.0
"""How many times more a felled body's joints resist than a limp one's. A guess: at 1
bodies that are thrown hard spin out of control."""
_LEVEL = np.array([1.0, 0.0, 1.0])
_ADDS_UP = 0.4  # s within which blows count as one. A guess.
_SOFTENS = 0.5  # m/s of the whole body by which a blow softens all it can. A guess.
_HARDENS = 0.5  # s that the pulls take to come back where the body was hit. A guess.
_SPREADS = 0.6  # of the softening there that the next joint has. A guess.
_GRASPS = 0.3  # s that the pulls take to come back to a body that lies. A guess.
_STILL, _LONGEST = 0.5, 4.0  # m/s below which, or s after which, a felled body rises
_RETURNS = 4.0  # 1/s, of what is left of the way, at its end. A guess.


class Compliance:
    """What blows do to the targets and the pulls of one body, y up.

    Attributes:
        felled: Whether nothing is to pull it, because of a blow.
        hold: Share of the pulls that a body that gets up has back, otherwise 1.
        gained: Acceleration of the target's sway [m/s^2], shape (J, 3).
    """

    def __init__(self, body: Body, tracking: GameTracking) -> None:
        self._body, self._tracking = body, tracking
        heights = body.rest_positions[:, 1]
        self._sways = np.clip(heights / heights[body.skeleton.girdle], 0.0, 1.0)
        self._swaying = float(joint_masses(body) @ self._sways**2)
        joints = len(heights)
        near = np.zeros((joints, joints))
        near[body.skeleton.segments, body.skeleton.segment_parents] = 1.0
        self._apart = shortest_path(near, directed=False, unweighted=True)
        self._soft = tracking.hit_frequency / tracking.natural_frequency
        self.start()

    def start(self) -> None:
        """Forget all blows."""
        joints = len(self._sways)
        self._impulses, self.gained = np.zeros((joints, 3)), np.zeros((joints, 3))
        self._blow, self._sway, self._speed = np.zeros((3, 3))
        self._softness = np.zeros(joints)
        self.felled, self.hold = False, 1.0
        self._lying: tuple[Array, Array] | None = None
        self._away, self._since = np.zeros(3), 0.0

    @property
    def doing(self) -> str:
        """What the character does, in words."""
        if self.felled:
            return "fell"
        if self._lying is None:
            return "follows"
        rises = self._since < self._tracking.rising
        return "gets up" if rises else "comes back"

    @property
    def upright(self) -> bool:
        """Whether the body follows, neither felled nor on its way back."""
        return self.doing == "follows"

    @property
    def strength(self) -> Array:
        """Natural frequency of the pull on each joint, as share of its own, (J,)."""
        return self.hold * (1.0 - (1.0 - self._soft) * self._softness)

    def hit(self, joint: int, impulse: Array) -> None:
        """Take in an impulse [N s], shape (3,), on the part that ends at a joint."""
        self._impulses[joint] += impulse

    def feel(
        self, model: mujoco.MjModel, data: mujoco.MjData, parts: Indices, props: Flags
    ) -> None:
        """Take in what props give the body in the step just made.

        Args:
            model: The scene.
            data: Its state.
            parts: For each body of the model the joint of the part, -1 for others.
            props: Which bodies can be moved.
        """
        force = np.empty(6)
        for k in range(data.ncon):
            one, other = model.geom_bodyid[data.contact.geom[k]]
            for part, thing, sign in ((one, other, -1.0), (other, one, 1.0)):
                if parts[part] >= 0 and props[thing]:
                    mujoco.mj_contactForce(model, data, k, force)
                    given = force[:3] @ data.contact.frame[k].reshape(3, 3)
                    impulse = sign * model.opt.timestep * given
                    self.hit(parts[part], from_mujoco(impulse))

    def fall(self, dt: float) -> bool:
        """Take in the blows of ``dt`` [s]; return whether they fell the body now."""
        impulses, tracking = self._impulses * _LEVEL, self._tracking
        self._impulses[:] = 0.0
        self._blow = self._blow * np.exp(-dt / _ADDS_UP) + impulses.sum(axis=0)
        size = float(np.linalg.norm(self._blow)) / self._body.mass
        if size > tracking.felling_speed:
            self.start()
            self.felled = True
            return True
        # The exact motion of the oscillator under a constant force.
        w = tracking.sway_frequency
        rest = self._sways @ impulses / (dt * self._swaying * w**2)
        start, before = self._sway - rest, self._speed
        drift, decay = before + w * start, np.exp(-w * dt)
        self._sway = rest + (start + drift * dt) * decay
        self._speed = (drift - w * (start + drift * dt)) * decay
        self.gained = self._sways[:, None] * (self._speed - before) / dt
        self._softness *= np.exp(-dt / _HARDENS)
        if impulses.any():
            hit = np.argmax(np.vecdot(impulses, impulses))
            here = min(size / _SOFTENS, 1.0) * _SPREADS ** self._apart[hit]
            self._softness = np.maximum(self._softness, here)
        return False

    def lies(self, dt: float, speed: float) -> bool:
        """Let a felled body lie for ``dt`` [s]; return whether it is to get up.

        Its hips have a speed [m/s].
        """
        self._since += dt
        still = speed < _STILL and self._since > self._tracking.lying
        return self.felled and (still or self._since > _LONGEST)

    def get_up(self, root: Array, rotations: Array, performer: Array) -> None:
        """Begin to pull a body that lies; arguments as its pose, and where to [m]."""
        self.start()
        self._lying, self.hold = (root, self._relative(rotations)), 0.0
        self._away = (root - performer) * _LEVEL

    def target(
        self, positions: Array, rotations: Array, dt: float
    ) -> tuple[Array, Array]:
        """Return the target of a frame ``dt`` [s] later as the blows have changed it.

        Joint positions [m], (J, 3), and world rotations, wxyz, (J, 4).
        """
        if self._lying is not None:
            self._since += dt
            self.hold = float(smooth_step(np.array(self._since / _GRASPS)))
            share = smooth_step(np.array(self._since / self._tracking.rising))
            root, relative = self._lying
            there = positions[self._body.skeleton.root] + self._away
            rotations = self._between(relative, self._relative(rotations), share)
            root = root + share * (there - root)
            positions = positions_from_rotations(rotations, root, self._body)
            if share == 1.0:
                self._go_back(dt)
        return positions + self._sways[:, None] * self._sway, rotations

    def _go_back(self, dt: float) -> None:
        """Let a body that stands again go to the performer."""
        distance = float(np.linalg.norm(self._away))
        eased = smooth_step(np.array(self._since - self._tracking.rising))
        pace = min(_RETURNS * distance, float(eased) * self._tracking.return_speed)
        if distance < 1e-3:
            self._lying = None
        else:
            self._away *= 1.0 - pace * dt / distance

    def _relative(self, rotations: Array) -> Array:
        """Return rotations relative to the parents', the root's to the world."""
        skeleton, found = self._body.skeleton, rotations.copy()
        above = inverse(rotations[skeleton.segment_parents])
        found[skeleton.segments] = multiply(above, rotations[skeleton.segments])
        return found

    def _between(self, one: Array, other: Array, share: Array) -> Array:
        """Return world rotations between relative ones.

        Not on the shortest arc, which joints may not allow: on a line of rotation
        vectors, whose angles are all within the joint's range.
        """
        skeleton = self._body.skeleton
        found = slerp(one, other, share)
        line = (1.0 - share) * rotation_vector(one) + share * rotation_vector(other)
        relative = Rotation.from_rotvec(line).as_quat(scalar_first=True)
        for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
            found[j] = multiply(found[p], relative[j])
        return found
