"""The visible props of a scene and how they move in a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from kinefilter.characters import Prop, Shape, ShapeKind
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import from_mujoco, to_mujoco
from kinefilter.characters.rotations import continuous
from kinefilter.retarget import HeadingFrame

from .holdable import mesh_points

_KINDS: dict[int, tuple[ShapeKind, list[int]]] = {
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", [0, 1, 2]),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("ellipsoid", [0, 0, 0]),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", [0, 1, 2]),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", [0, 0, 1]),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): ("capsule", [0, 0, 1]),
    int(mujoco.mjtGeom.mjGEOM_MESH): ("mesh", [0, 1, 2]),
}
"""Kind of shape by type of geom, and which of its sizes are the half extents."""
_FREE = mujoco.mjtJoint.mjJNT_FREE
_LAST_VISIBLE = 2  # group of geoms that MuJoCo's own viewer shows by default
_OVERLAP = 0.01  # m: props that are put deeper into something are flung out
_RAISE, _RAISES = 0.05, 100  # m, and how often a prop is raised at most. Guesses.
_UNSET = (0.5, 0.5, 0.5, 1.0)  # the color of a geom that has none of its own


class SceneProps:
    """The visible props of a scene, recorded frame by frame.

    That is, all bodies but those of ``characters``, the indices of their root bodies.
    ``poses`` has positions [m] and rotations, wxyz, of the props that can move, in
    MuJoCo's world, shape (frames, N, 7).
    """

    def __init__(
        self, data: mujoco.MjData, characters: Sequence[int], frames: int
    ) -> None:
        model = data.model
        self._data, self._model = data, model
        visible = np.isin(model.geom_type, list(_KINDS)) & (model.geom_rgba[:, 3] > 0.0)
        visible &= model.geom_group <= _LAST_VISIBLE
        self._geoms: dict[int, list[int]] = {}
        for geom in np.flatnonzero(visible).tolist():
            body = int(model.geom_bodyid[geom])
            if model.body_rootid[body] not in characters:
                self._geoms.setdefault(body, []).append(geom)
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
        return tuple(map(self._name, self._moving))

    @property
    def now(self) -> tuple[Array, Array]:
        """Last positions [m], (N, 3), and rotations, wxyz, (N, 4), of these props."""
        poses = self.poses[-1]
        return from_mujoco(poses[:, :3]), from_mujoco(poses[:, 3:])

    def _name(self, body: int) -> str:
        return self._model.body(body).name or f"body{body}"

    def name_of(self, geom: int) -> str:
        """Return the name of the prop that a geom of the model is part of."""
        body = int(self._model.geom_bodyid[geom])
        return self._name(body) if body else self._model.geom(geom).name or "floor"

    def put(self, name: str, position: Array, rotation: Array) -> bool:
        """Put a prop at a position [m] and rotation, wxyz, at rest, where it has room.

        From inside the floor, people or things it would be flung out, so it is raised
        above them. Returns False if no prop of that name moves freely, or has room.
        """
        if (joint := self._free_joint(name)) is None:
            return False
        model, trial = self._model, mujoco.MjData(self._model)
        trial.qpos[:] = self._data.qpos
        own = model.body_rootid[model.geom_bodyid] == model.jnt_bodyid[joint.id]
        place = trial.joint(joint.id).qpos
        place[:3], place[3:] = to_mujoco(position), to_mujoco(rotation)
        place[2] = max(place[2], 0.0)
        for _ in range(_RAISES):
            mujoco.mj_kinematics(model, trial)
            mujoco.mj_collision(model, trial)
            with_others = own[trial.contact.geom].sum(axis=1) == 1
            if not (with_others & (trial.contact.dist < -_OVERLAP)).any():
                joint.qpos[:], joint.qvel[:] = place, 0.0
                return True
            place[2] += _RAISE
        return False

    def _free_joint(self, name: str) -> Any:
        """Return the joint, in MuJoCo's data, of a prop that moves freely, or None."""
        for body in self._moving:
            joint = int(self._model.body_jntadr[body])
            if self._name(body) == name and self._model.jnt_type[joint] == _FREE:
                return self._data.joint(joint)
        return None

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
            points, mesh = mesh_points(model, geom), model.mesh(model.geom_dataid[geom])
            points = from_mujoco(points.astype(float))
            first, count = int(mesh.faceadr[0]), int(mesh.facenum[0])
            triangles = model.mesh_face[first : first + count].astype(np.int64)
        color, material = model.geom_rgba[geom], int(model.geom_matid[geom])
        if material >= 0 and np.allclose(color, _UNSET):
            color = model.mat_rgba[material]
        size, place = model.geom_size[geom][sizes], model.geom_pos[geom]
        frame = (size, place, model.geom_quat[geom])
        size, place, turn = map(from_mujoco, frame)
        rgb = color[:3].astype(float)
        return Shape(kind, size, place, turn, rgb, points, triangles)
