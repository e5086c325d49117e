"""The physics filter: a capsule humanoid pulled through the corrected motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Prop, Shape, ShapeKind, positions_from_rotations
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.gaps import LONG_GAP
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import continuous
from kinefilter.retarget import HeadingFrame

from .pulled_character import PulledCharacter

_SETTLING = 10  # frames of 1/30 s: longer than a foot takes to bear the body
_CHUNK = 4096  # frames at a time, to bound the memory
_KINDS: dict[int, ShapeKind] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}
_LAST_SHOWN = 2  # group of geoms that MuJoCo's own viewer shows
_UNSET = (0.5, 0.5, 0.5, 1.0)  # the color of a geom that has none of its own


class Things:
    """The visible bodies of a model that are not the character's, frame by frame.

    Args:
        model: A compiled scene.
        data: Its state, of which ``record`` takes the poses.
        character: Index of the character's root body.
        frames: How many frames there will be.

    ``poses`` are places [m] and rotations of what moves, MuJoCo's, (frames, N, 7).
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, character: int, frames: int
    ) -> None:
        self._model, self._data = model, data
        shown = [g for g in range(model.ngeom) if _is_shown(model, g)]
        self._geoms = {
            int(body): [g for g in shown if model.geom_bodyid[g] == body]
            for body in dict.fromkeys(model.geom_bodyid[shown])
            if model.body_rootid[body] != character
        }
        self._moving = [b for b in self._geoms if model.body_weldid[b] != 0]
        self.poses = np.empty((frames, len(self._moving), 7))

    def record(self, frame: int) -> None:
        """Record the pose of everything that can move."""
        if self._moving:
            self.poses[frame, :, :3] = self._data.xpos[self._moving]
            self.poses[frame, :, 3:] = self._data.xquat[self._moving]

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the props that can move."""
        return tuple(self._name(body) for body in self._moving)

    @property
    def now(self) -> tuple[Array, Array]:
        """Where these were last [m], (N, 3), and their rotations, wxyz, (N, 4)."""
        poses = self.poses[-1]
        return from_mujoco(poses[:, :3]), from_mujoco(poses[:, 3:])

    def _name(self, body: int) -> str:
        return self._model.body(body).name or f"body{body}"

    def props(self, place: HeadingFrame) -> tuple[Prop, ...]:
        """Return the things and their motion in the world frame of a take.

        Args:
            place: What was taken out of the take's positions to land in the scene.
        """
        return tuple(self._prop(body, place) for body in self._geoms)

    def _prop(self, body: int, place: HeadingFrame) -> Prop:
        poses = np.append(self._data.xpos[body], self._data.xquat[body])[None]
        if body in self._moving:
            poses = self.poses[:, self._moving.index(body)]
        return Prop(
            self._name(body),
            tuple(self._shape(geom) for geom in self._geoms[body]),
            place.restore(from_mujoco(poses[:, None, :3]))[:, 0],
            continuous(place.restore_rotations(from_mujoco(poses[:, 3:]))),
        )

    def _shape(self, geom: int) -> Shape:
        model = self._model
        kind = _KINDS[int(model.geom_type[geom])]
        points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        if kind == "mesh":
            mesh = model.mesh(model.geom_dataid[geom])
            first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            points = from_mujoco(model.mesh_vert[first : first + count].astype(float))
            first, count = int(mesh.faceadr[0]), int(mesh.facenum[0])
            triangles = model.mesh_face[first : first + count].astype(np.int64)
        return Shape(
            kind,
            from_mujoco(_half_extents(model, geom)),
            from_mujoco(model.geom_pos[geom].copy()),
            from_mujoco(model.geom_quat[geom].copy()),
            _color(model, geom),
            points,
            triangles,
        )


@dataclass(frozen=True, eq=False)
class PhysicsTrace:
    """What the simulation did, frame by frame; arrays of shape (T,)."""

    tracking_error: Array
    """Mean distance of the joints from their targets [m]."""
    external_force: Array
    """Mean force over the frame that no muscle and no floor gives [body weights]."""
    contacts: NDArray[np.int64]
    """Number of points in which the character touches itself or anything else."""
    reset: Flags
    """The character was put back onto its target: the step had diverged, or a limb was
    stuck at the end of its joint's range (``stuck_limbs``)."""

    @property
    def status(self) -> str:
        """``ok``, or how many frames had to be reset."""
        resets = int(self.reset.sum())
        if resets == 0:
            return "ok"
        return f"character reset onto its target in {resets} frame{'s' * (resets != 1)}"


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
        stands: Flags | None = None,
        frames: Iterable[int] | None = None,
    ) -> PhysicsResult:
        """Pull the character through a whole motion; it starts again after long gaps.

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
            standing = None if stands is None else stands[k]
            if k == 0 or time[k] - time[k - 1] > LONG_GAP:
                self.start(positions[k], rotations[k], anew=k == 0)
                # Hold the first target until the start-up transient is gone.
                first, turns = (from_mujoco(value) for value in self._target)
                for _ in range(_SETTLING):
                    self.step(first, turns, 1 / 30, stands=standing)
            else:
                trace.reset[k] = not self.step(
                    positions[k],
                    rotations[k],
                    float(time[k] - time[k - 1]),
                    acceleration=accelerations[k],
                    stands=standing,
                )
            result[k] = self.rotations
            roots[k] = self.root
            trace.tracking_error[k] = self.tracking_error
            trace.external_force[k] = self.external_force
            trace.contacts[k] = self.contacts
            things.record(k)
        result = continuous(result)
        joints = np.empty_like(positions)
        for some in chunks(count, _CHUNK):
            joints[some] = positions_from_rotations(
                result[some], roots[some], self.body
            )
        return PhysicsResult(result, joints, trace, things)


def _accelerations(time: Array, positions: Array) -> Array:
    """Return accelerations [m/s^2] of a motion, of which each step knows the next."""
    found = np.zeros_like(positions)
    if len(time) > 2:
        steps = np.diff(time)
        velocities = np.diff(positions, axis=0) / steps[:, None, None]
        found[1:-1] = (velocities[1:] - velocities[:-1]) / (
            0.5 * (steps[1:] + steps[:-1])
        )[:, None, None]
        found[1:-1][np.maximum(steps[1:], steps[:-1]) > LONG_GAP] = 0.0
    return found


def _is_shown(model: mujoco.MjModel, geom: int) -> bool:
    return (
        int(model.geom_type[geom]) in _KINDS
        and model.geom_group[geom] <= _LAST_SHOWN
        and model.geom_rgba[geom, 3] > 0.0
    )


def _half_extents(model: mujoco.MjModel, geom: int) -> Array:
    """Return half extents of a geom [m] in MuJoCo's axes, shape (3,)."""
    a, b, c = model.geom_size[geom].tolist()
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.array([a, a, a])
    if _KINDS[int(model.geom_type[geom])] in ("cylinder", "capsule"):
        return np.array([a, a, b])
    return np.array([a, b, c])


def _color(model: mujoco.MjModel, geom: int) -> Array:
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    if material >= 0 and np.allclose(own, _UNSET):
        own = model.mat_rgba[material]
    return np.asarray(own[:3], dtype=np.float64)
