"""What a simulated scene holds beside the character, and how it moves."""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Prop, Shape, ShapeKind
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import continuous
from kinefilter.retarget import HeadingFrame

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
        self._poses = np.empty((frames, len(self._moving), 7))

    def record(self, frame: int) -> None:
        """Take down where everything that can move is now."""
        if self._moving:
            self._poses[frame, :, :3] = self._data.xpos[self._moving]
            self._poses[frame, :, 3:] = self._data.xquat[self._moving]

    def props(self, place: HeadingFrame) -> tuple[Prop, ...]:
        """Return the things and their motion in the world frame of a take.

        Args:
            place: What was taken out of the take's positions to land in the scene.
        """
        return tuple(self._prop(body, place) for body in self._geoms)

    def _prop(self, body: int, place: HeadingFrame) -> Prop:
        if body in self._moving:
            poses = self._poses[:, self._moving.index(body)]
        else:
            poses = np.concatenate([self._data.xpos[body], self._data.xquat[body]])[
                None
            ]
        return Prop(
            self._model.body(body).name or f"body{body}",
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
