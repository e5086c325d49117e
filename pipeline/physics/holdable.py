"""Props that hands can hold, in MuJoCo's world; points are given y up."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.humanoid import from_mujoco, prefix_of, to_mujoco
from kinefilter.characters.rotations import cross, unit
from kinefilter.retarget.limbs import at_most

HANDS = ("HandLeft", "HandRight")
HORIZONTAL = np.array([1.0, 0.0, 1.0])
UP = np.array([0.0, 1.0, 0.0])
_MESH = mujoco.mjtGeom.mjGEOM_MESH
_SITE = mujoco.mjtObj.mjOBJ_SITE
_ENGINE_UP = to_mujoco(UP)
_MOVES = (
    mujoco.mjtJoint.mjJNT_FREE,
    mujoco.mjtJoint.mjJNT_HINGE,
    mujoco.mjtJoint.mjJNT_SLIDE,
)

# Guesses.
_WIDTHS = (0.12, 0.7)  # m: thinner props need one hand, wider ones longer arms
_THIN = 0.1  # m: what one hand can hold is thinner somewhere
_ABOVE = 0.6  # of half its height: hands hold it no higher above its center, nor below
_TOUCH = 0.04  # m across from a face: a hand that touches
_FACE = 0.6  # of half the face: how far from its place a hand still holds it
_FAR = 0.3  # m: hands farther away from a prop do not go to it
_SLACK = 0.01  # m below a prop: nearer things support it
_ALONG = 0.7  # cosine of the angle between a prop's axis and the line of the hands
_LEVELING = 15.0  # rad/s: natural frequency at which held props turn level
_WRISTS = 20.0  # N m of both wrists together
STRENGTH = 300.0  # largest force of each hand [N]


def add_ties(spec: mujoco.MjSpec, characters: int = 1) -> None:
    """Add loose ties of the hands of all characters to each movable prop of a scene.

    Props without names get that of ``SceneProps``, as ties need one.
    """
    bodies = enumerate(spec.bodies)  # the characters' joints are roots and balls
    props = [(k, b) for k, b in bodies if any(j.type in _MOVES for j in b.joints)]
    hands = [f"{prefix_of(n)}{hand}" for n in range(characters) for hand in HANDS]
    for k, prop in props[characters:]:  # the first are the characters' roots
        prop.name = prop.name or f"body{k}"
        for hand in hands:
            tie = spec.add_equality(name=f"hold:{prop.name}:{hand}", active=False)
            tie.type, tie.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_BODY
            tie.name1, tie.name2, tie.solref = hand, prop.name, [0.02, 1.0]


def _props_of(model: mujoco.MjModel) -> Indices:
    """Return the body that each geom moves with, which may have none of its own."""
    return np.asarray(model.body_weldid[model.geom_bodyid])


def mesh_points(model: mujoco.MjModel, geom: int) -> Array:
    """Return the points of a geom's mesh [m], in the frame of the geom, (N, 3)."""
    mesh = model.mesh(model.geom_dataid[geom])
    first = int(mesh.vertadr[0])
    return np.asarray(model.mesh_vert[first : first + int(mesh.vertnum[0])])


def _corners(data: mujoco.MjData, geom: int) -> Array:
    """Return the corners of a mesh, or of the box around another geom, (N, 3) [m]."""
    model = data.model
    if model.geom_type[geom] == _MESH:
        points = mesh_points(model, geom)
    else:
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        points = middle + half * (2.0 * np.indices((2, 2, 2)).reshape(3, 8).T - 1.0)
    turn = data.geom_xmat[geom].reshape(3, 3)
    return np.asarray(data.geom_xpos[geom] + points @ turn.T)


class Holdable:
    """A movable prop, tied to the character's ``hands``, by the names of their bodies.

    ``palm`` is the distance of the hands' surface from their joints [m].
    """

    def __init__(
        self, data: mujoco.MjData, body: int, palm: float, hands: tuple[str, str]
    ) -> None:
        model = data.model
        self._data, self._model = data, model
        self.body, self._palm = body, palm
        self.name = model.body(body).name
        self._ties = [model.equality(f"hold:{self.name}:{hand}").id for hand in hands]
        self._hands = [model.body(hand).id for hand in hands]
        self._palms = [model.site(hand).id for hand in hands]
        geoms = np.flatnonzero((_props_of(model) == body) & (model.geom_contype != 0))
        # A single simple shape has axes of its own; others have those of the body.
        kind = model.geom_type[geoms[0]] if len(geoms) == 1 else _MESH
        self.round = bool(kind == mujoco.mjtGeom.mjGEOM_SPHERE)
        frame = data.xmat[body] if kind == _MESH else data.geom_xmat[geoms[0]]
        self._turn = data.xmat[body].reshape(3, 3).T @ frame.reshape(3, 3)
        points = [_corners(data, int(geom)) for geom in geoms]
        points = (np.concatenate(points) - data.xpos[body]) @ frame.reshape(3, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        self._middle, self._half = self._turn @ (0.5 * (low + high)), 0.5 * (high - low)
        self._geoms = geoms.tolist()
        # Of the boxes around its parts, each along its own axes.
        self._thinnest = 2.0 * float(model.geom_aabb[geoms, 3:].min())
        self._size = float(np.linalg.norm(np.abs([low, high]).max(axis=0)))
        self._lay = np.zeros(3)  # up, in its own frame, when it was tied
        self.is_free = bool(model.jnt_type[model.body_jntadr[body]] == _MOVES[0])
        first = int(model.body_dofadr[body])
        self._speed = slice(first, first + 3)
        self.weight = float(model.body_subtreemass[body]) * GRAVITY

    @staticmethod
    def all(data: mujoco.MjData, palm: float, hands: tuple[str, str]) -> list[Holdable]:
        """Return all props with ties."""
        model = data.model
        mujoco.mj_kinematics(model, data)
        solid = set(_props_of(model)[model.geom_contype != 0])
        tied = {f"hold:{model.body(k).name}:{hands[0]}": int(k) for k in solid}
        names = [model.equality(k).name for k in range(model.neq)]
        return [Holdable(data, tied[n], palm, hands) for n in names if n in tied]

    @property
    def for_two(self) -> bool:
        """Whether it takes two hands, as it is free to move and not too small."""
        return self.is_free and bool(2.0 * self._half.max() > _WIDTHS[0])

    @property
    def for_one(self) -> bool:
        """Whether a single hand can hold it."""
        return not self.for_two and self._thinnest < _THIN

    @property
    def _matrix(self) -> Array:
        return np.asarray(self._data.xmat[self.body].reshape(3, 3))

    @property
    def center(self) -> Array:
        """Center of the box around it [m], shape (3,)."""
        return from_mujoco(self._data.xpos[self.body] + self._matrix @ self._middle)

    @property
    def _axes(self) -> Array:
        """Directions along its edges, rows (3, 3)."""
        return from_mujoco((self._matrix @ self._turn).T)

    def extent(self, direction: Array) -> float:
        """Return its half extent along a unit vector (3,) [m]."""
        if self.round:
            return float(self._half[0])
        return float(np.abs(self._axes @ direction) @ self._half)

    def places(self, hands: Array) -> Array | None:
        """Return where hands at (2, 3) are to hold it [m], (2, 3); None if nowhere."""
        along = unit((hands[0] - hands[1]) * HORIZONTAL)
        axes = along[None] if self.round else self._axes
        k = int(np.abs(axes @ along).argmax())
        side = axes[k] * np.sign(axes[k] @ along)
        if side @ along < _ALONG or not _WIDTHS[0] < 2.0 * self._half[k] < _WIDTHS[1]:
            return None
        raised, most = float(hands[:, 1].mean() - self.center[1]), self.extent(UP)
        raised = 0.0 if self.round else float(np.clip(raised, 0.0, _ABOVE * most))
        reach = (self._half[k] + self._palm) * np.array([side, -side])
        return np.asarray(self.center + raised * UP + reach)

    def touched(self, hands: Array) -> bool:
        """Return True if hands at (2, 3) [m] are where they can hold it."""
        if (places := self.places(hands)) is None:
            return False
        away, side = hands - places, unit(places[0] - places[1])
        across = away @ side
        along = np.linalg.norm(away - across[:, None] * side, axis=-1)
        near = _FACE * min(self.extent(UP), self.extent(unit(cross(side, UP))))
        return bool(np.abs(across).max() < _TOUCH and along.max() < near)

    def tie(self, hands: Array) -> None:
        """Tie the hands to the faces where they are, at (2, 3) [m]."""
        points = hands + self._palm * unit(hands[::-1] - hands)
        for number, point in enumerate(points):
            self.tie_one(number, point)

    def tie_one(self, number: int, point: Array) -> None:
        """Tie one hand, 0 left or 1 right, to a point of the prop [m], (3,)."""
        data, place, tie = self._data, to_mujoco(point), self._ties[number]
        for body, part in ((self._hands[number], 0), (self.body, 3)):
            local = data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])
            self._model.eq_data[tie, part : part + 3] = local
        data.eq_active[tie] = 1
        self._lay = self._matrix[2].copy()

    def take_over(self, other: Holdable) -> None:
        """Tie the hands as those of the same character in another world are tied."""
        self._model.eq_data[self._ties] = other._model.eq_data[other._ties]
        self._data.eq_active[self._ties] = other._data.eq_active[other._ties]
        self._lay = other._lay

    @property
    def is_tied(self) -> bool:
        """Whether it is tied to a hand of this character."""
        return bool(self._data.eq_active[self._ties].any())

    def way_from(self, number: int) -> Array | None:
        """Return the way from the surface of a hand to its own [m]; None if far."""
        data, model, best, found = self._data, self._model, _FAR, None
        hand = self._hands[number]
        if np.linalg.norm(data.xpos[hand] - data.xpos[self.body]) > _FAR + self._size:
            return None
        ends = np.zeros(6)
        for one in np.flatnonzero(model.geom_bodyid == hand):
            for other in self._geoms:
                far = mujoco.mj_geomDistance(model, data, one, other, best, ends)
                if far < best:
                    best, found = far, np.where(far > 0.0, ends[3:] - ends[:3], 0.0)
        return None if found is None else from_mujoco(found)

    @property
    def reach(self) -> float:
        """Distance of a hand from the center of a round prop that it touches [m]."""
        return float(self._half[0]) + self._palm

    @property
    def velocity(self) -> Array:
        """Velocity of its body [m/s], shape (3,)."""
        return from_mujoco(self._data.qvel[self._speed])

    @property
    def from_palms(self) -> float:
        """Distance of its body from the middle between both palms [m]."""
        data = self._data
        off = data.site_xpos[self._palms].mean(axis=0) - data.xpos[self.body]
        return float(np.linalg.norm(off))

    def stay_at(self, hands: Sequence[int], frequency: float) -> Array:
        """Pull it under a palm, or between both (0, 1); return the force [N].

        The force is that of a critically damped spring of a frequency [rad/s], in
        MuJoCo's world, shape (3,), for the next step of the engine.
        """
        data, moves = self._data, np.empty((len(hands), 6))
        sites = [self._palms[hand] for hand in hands]
        for site, move in zip(sites, moves, strict=True):
            mujoco.mj_objectVelocity(self._model, data, _SITE, site, move, 0)
        off = data.site_xpos[sites].mean(axis=0) - data.xpos[self.body]
        if len(hands) == 1:
            off -= self.reach * _ENGINE_UP
        slower = moves[:, 3:].mean(axis=0) - data.qvel[self._speed]
        return self.push(frequency * (frequency * off + 2.0 * slower))

    def push(self, acceleration: Array) -> Array:
        """Accelerate it beyond gravity [m/s^2], (3,); return the force as above."""
        mass = self.weight / GRAVITY
        force = at_most(STRENGTH, mass * acceleration + self.weight * _ENGINE_UP)
        self._data.xfrc_applied[self.body, :3] = force
        return force

    def untie(self) -> None:
        """Let the hands go."""
        self._data.eq_active[self._ties] = 0
        self._data.xfrc_applied[self.body] = 0.0

    def put_back(self) -> None:
        """Put it where the scene has it, at rest."""
        joint = self._data.joint(int(self._model.body_jntadr[self.body]))
        joint.qpos[:] = self._model.joint(joint.id).qpos0
        joint.qvel[:] = 0.0

    @property
    def pulls(self) -> Array:
        """Force of each tie [N], shape (2,)."""
        data, kind = self._data, int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        force = data.efc_force * (data.efc_type == kind)
        return np.array([np.linalg.norm(force[data.efc_id == t]) for t in self._ties])

    @property
    def supported(self) -> bool:
        """Whether it touches anything but the character."""
        model = self._model
        pairs = _props_of(model)[self._data.contact.geom]
        touched = pairs[(pairs == self.body).any(axis=1)].ravel()
        roots = model.body_rootid[touched[touched != self.body]]
        return bool((roots != model.body_rootid[self._hands[0]]).any())

    @property
    def rests(self) -> bool:
        """Whether something is right beneath its center."""
        height, down = self.extent(UP) + _SLACK, to_mujoco(-UP)
        # From beneath it, as rays also hit what they start in.
        start = to_mujoco(self.center - (height - 2.0 * _SLACK) * UP)
        engine, found = (self._model, self._data), np.zeros(1, dtype=np.int32)
        far = mujoco.mj_ray(*engine, start, down, None, 1, self.body, found)
        return bool(0.0 <= far < 3.0 * _SLACK)

    def turn_level(self) -> None:
        """Turn it as level as it was when tied, with the torque of both wrists.

        A single hand bears it beside its center of mass. What has a hinge or a rail
        turns as that lets it.
        """
        if not self.is_free:
            return
        data, body = self._data, self.body
        up, spin = self._matrix @ self._lay, data.cvel[body, :3]
        turning = _LEVELING**2 * np.cross(up, [0.0, 0.0, 1.0]) - 2.0 * _LEVELING * spin
        inertia = float(self._model.body_inertia[body].max())
        torque, tied = inertia * turning, data.eq_active[self._ties]
        if not tied.all():
            (tie,) = np.array(self._ties)[tied != 0]
            point = data.xpos[body] + self._matrix @ self._model.eq_data[tie, 3:6]
            lever = data.xipos[body] - point
            across = turning * (lever @ lever) - lever * (lever @ turning)
            torque = torque + self.weight / GRAVITY * across
            torque += np.cross(lever, self.weight * _ENGINE_UP)
        data.xfrc_applied[body, 3:] = at_most(_WRISTS, torque)
