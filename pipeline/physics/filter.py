"""The physics filter: a capsule humanoid pulled through the corrected motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Prop, Shape, ShapeKind, positions_from_rotations
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.gaps import LONG_GAP
from kinefilter.characters.humanoid import from_mujoco, to_mujoco
from kinefilter.characters.rotations import continuous
from kinefilter.retarget import HeadingFrame

from .moves import Move
from .pulled_character import PulledCharacter, check_target

SETTLING = 10  # frames of 1/30 s: longer than a foot takes to bear the body
_CHUNK = 4096  # frames at a time, to bound the memory
_KINDS: dict[int, tuple[ShapeKind, list[int]]] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", [0, 1, 2]),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("ellipsoid", [0, 0, 0]),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", [0, 1, 2]),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", [0, 0, 1]),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", [0, 0, 1]),
    int(mujoco.mjtGeom.mjGEOM_MESH): ("mesh", [0, 1, 2]),
}
"""Kind of shape by type of geom, and which of its sizes are the half extents."""
_LAST_VISIBLE = 2  # group of geoms that MuJoCo's own viewer shows by default
_UNSET = (0.5, 0.5, 0.5, 1.0)  # the color of a geom that has none of its own


class SceneProps:
    """The visible props of a scene, recorded frame by frame.

    That is, all bodies but those of ``characters``, the indices of their root bodies.
    ``poses`` has positions [m] and rotations, wxyz, of the props that can move, in
    MuJoCo's world, shape (frames, N, 7).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        characters: Sequence[int],
        frames: int,
    ) -> None:
        self._model, self._data = model, data
        visible = np.flatnonzero(
            np.isin(model.geom_type, list(_KINDS))
            & (model.geom_group <= _LAST_VISIBLE)
            & (model.geom_rgba[:, 3] > 0.0)
        )
        self._geoms = {
            int(body): [int(g) for g in visible if model.geom_bodyid[g] == body]
            for body in dict.fromkeys(model.geom_bodyid[visible])
            if model.body_rootid[body] not in characters
        }
        self._moving = [b for b in self._geoms if model.body_weldid[b] != 0]
        self.poses = np.empty((frames, len(self._moving), 7))

    def record(self, frame: int) -> None:
        """Record the current poses as those of a frame."""
        if self._moving:
            self.poses[frame, :, :3] = self._data.xpos[self._moving]
            self.poses[frame, :, 3:] = self._data.xquat[self._moving]

    @property
    def moving(self) -> tuple[str, ...]:
        """Names of the props that can move."""
        return tuple(self._name(body) for body in self._moving)

    @property
    def now(self) -> tuple[Array, Array]:
        """Last positions [m], (N, 3), and rotations, wxyz, (N, 4), of these props."""
        poses = self.poses[-1]
        return from_mujoco(poses[:, :3]), from_mujoco(poses[:, 3:])

    def _name(self, body: int) -> str:
        return self._model.body(body).name or f"body{body}"

    def props(self, place: HeadingFrame) -> tuple[Prop, ...]:
        """Return the props and their motion in the world frame of a take.

        ``place`` is the frame that was removed from the take to put it into the scene.
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
        kind, sizes = _KINDS[int(model.geom_type[geom])]
        points, triangles = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        if kind == "mesh":
            mesh = model.mesh(model.geom_dataid[geom])
            first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
            points = from_mujoco(model.mesh_vert[first : first + count].astype(float))
            first, count = int(mesh.faceadr[0]), int(mesh.facenum[0])
            triangles = model.mesh_face[first : first + count].astype(np.int64)
        color, material = model.geom_rgba[geom], int(model.geom_matid[geom])
        if material >= 0 and np.allclose(color, _UNSET):
            color = model.mat_rgba[material]
        return Shape(
            kind,
            from_mujoco(model.geom_size[geom][sizes]),
            from_mujoco(model.geom_pos[geom]),
            from_mujoco(model.geom_quat[geom]),
            color[:3].astype(float),
            points,
            triangles,
        )


@dataclass(frozen=True, eq=False)
class PhysicsTrace:
    """Record of a simulation, frame by frame; arrays of shape (T,)."""

    tracking_error: Array
    """Mean distance of the joints from their targets [m]."""
    external_force: Array
    """Mean force over the frame that only the pulls explain [body weights]."""
    contacts: NDArray[np.int64]
    """Number of points in which the character touches itself or anything else."""
    reset: Flags
    """True where the character was reset onto its target: the simulation had diverged,
    or a limb was stuck at the end of its joint's range (``stuck_limbs``)."""

    @property
    def status(self) -> str:
        """``ok``, or the number of frames with a reset."""
        resets = int(self.reset.sum())
        frames = f"{resets} frame{'s' * (resets != 1)}"
        return f"character reset onto its target in {frames}" if resets else "ok"


@dataclass(frozen=True, eq=False)
class PhysicsResult:
    """The simulated motion."""

    rotations: Array
    """World segment rotations, wxyz, shape (T, J, 4)."""
    positions: Array
    """Joint positions [m], world frame, shape (T, J, 3)."""
    trace: PhysicsTrace
    scene_props: SceneProps
    """The props of the scene, in the frame of the targets."""


class PhysicsFilter(PulledCharacter):
    """Pulls the humanoid of one body through whole motions."""

    def run(
        self,
        time: Array,
        positions: Array,
        rotations: Array,
        *,
        stands: Flags | None = None,
        seen: Flags | None = None,
        frames: Iterable[int] | None = None,
    ) -> PhysicsResult:
        """Pull the character through a whole motion; it restarts after long gaps.

        Time stamps [s] increase strictly, shape (T,); targets are as in ``step``, with
        a leading axis T. ``stands`` says whether each foot (left, right) bears weight,
        ``seen`` whether the sensor sees each hand, both of shape (T, 2). ``frames``
        yields 0 to T - 1, for example for a progress bar.
        """
        count = len(time)
        check_target(positions, rotations)
        accelerations = accelerations_of(time, positions)
        result, roots = np.empty_like(rotations), np.empty((count, 3))
        types = (float, float, np.int64, np.bool_)
        trace = PhysicsTrace(*(np.zeros(count, dtype) for dtype in types))
        things = SceneProps(self.model, self.data, [self.root_body], count)
        own = np.isin(self.model.geom_bodyid, self._bodies)
        for k in range(count) if frames is None else frames:
            if k % _CHUNK == 0:
                moves = self._moves(time, positions, rotations, accelerations, k)
            target, dt = (positions[k], rotations[k]), float(time[k] - time[k - 1])
            feet = None if stands is None else stands[k]
            if k == 0 or dt > LONG_GAP:
                self.start(*target, reset_props=k == 0)
                # Hold the first target until the initial transient is gone.
                for _ in range(SETTLING):
                    self.step(*target, 1 / 30, stands=feet)
            elif self.compliance is None and not self.grasp.props:
                trace.reset[k] = not self.world.follow([moves[k % _CHUNK]], [feet])[0]
            else:  # which changes the targets
                gained = accelerations[k]
                hands = None if seen is None else seen[k]
                good = self.step(
                    *target, dt, acceleration=gained, stands=feet, seen=hands
                )
                trace.reset[k] = not good
            result[k], roots[k] = self.data.xquat[self._bodies], self.data.qpos[:3]
            trace.external_force[k] = self.external_force
            if self.data.ncon:
                trace.contacts[k] = own[self.data.contact.geom].any(axis=1).sum()
            things.record(k)
        joints = np.empty_like(positions)
        for some in chunks(count, _CHUNK):
            result[some], places = from_mujoco(result[some]), from_mujoco(roots[some])
            joints[some] = positions_from_rotations(result[some], places, self.body)
            away = np.linalg.norm(joints[some] - positions[some], axis=-1)
            trace.tracking_error[some] = away.mean(axis=-1)
        return PhysicsResult(continuous(result), joints, trace, things)

    def _moves(
        self,
        time: Array,
        positions: Array,
        rotations: Array,
        accelerations: Array,
        first: int,
    ) -> Move:
        """Return the moves to a chunk of targets, the first of which has index k."""
        there = slice(first, first + _CHUNK)
        back = np.maximum(np.arange(len(time))[there] - 1, 0)
        dt = time[there] - time[back]
        return self._plan(
            (to_mujoco(positions[back]), to_mujoco(rotations[back])),
            (to_mujoco(positions[there]), to_mujoco(rotations[there])),
            to_mujoco(accelerations[there]),
            np.where(dt > 0.0, dt, 1.0),  # the very first is not used
            self._damping,
        )


def accelerations_of(time: Array, positions: Array) -> Array:
    """Return central second differences [m/s^2], 0 at the ends of each part."""
    accelerations, steps = np.zeros_like(positions), np.diff(time)[:, None, None]
    velocities = np.diff(positions, axis=0) / steps
    inner = (velocities[1:] - velocities[:-1]) / (0.5 * (steps[1:] + steps[:-1]))
    longest = np.maximum(steps[1:], steps[:-1])
    accelerations[1:-1] = np.where(longest > LONG_GAP, 0.0, inner)
    return accelerations
