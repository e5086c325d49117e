"""A body in a scene, posed frame by frame, and rays that go from a sensor into it.

Every segment is a MuJoCo body with the capsules it has, put where the motion says. The
rays are MuJoCo's.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, InputError, Motion
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco

_CHEST_BREADTH = 0.174  # of stature (Drillis & Contini 1966 in Winter 2009, fig. 4.1)
_HIP_BREADTH = 0.191
TRUNK = (
    *("HipCenter", "Spine", "ShoulderCenter"),
    *("SpineBase", "SpineMid", "SpineShoulder"),
)
"""Joints whose segments are the trunk."""
_FAR = 20.0  # m: beyond any Kinect's range
_PREFIX = "seen:"  # keeps the names of the body apart from those of the scene


def check_prop_poses(motion: Motion, prop_poses: Mapping[str, Array]) -> None:
    """Raise an InputError for poses of props that do not fit the motion."""
    for name, poses in prop_poses.items():
        if np.shape(poses) != (len(motion), 7):
            raise InputError(
                f"poses of prop {name!r} have shape {np.shape(poses)}, expected "
                f"{(len(motion), 7)}: position and quaternion in every frame"
            )


class PosedBody:
    """A body in a scene, and what rays meet there.

    Args:
        body: Whose segments are put where a motion has them.
        scene: The room and its props, z up as MuJoCo has it; by default a bare floor.
        moving: Names of the props that move.

    Raises:
        InputError: A moving prop is no body of the scene, not a child of its world.
    """

    def __init__(
        self,
        body: Body,
        scene: mujoco.MjSpec | None = None,
        moving: tuple[str, ...] = (),
    ) -> None:
        self.skeleton = body.skeleton
        self.model = _with_body(scene, body, moving).compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        names = [_PREFIX + j for j in body.skeleton.joints] + list(moving)
        ids = [self.model.body(name).id for name in names]
        self._slots = self.model.body_mocapid[ids]
        owner = {i: j for j, i in enumerate(ids[: len(body.skeleton)])}
        self.segment = np.array(
            [owner.get(b, -1) for b in self.model.geom_bodyid] + [-1]
        )
        """Index of the segment that each geom is of, -1: of the scene; last: none."""

    def cast(
        self,
        positions: Array,
        rotations: Array,
        props: list[Array],
        eye: Array,
        rays: Array,
    ) -> tuple[Array, NDArray[np.int32]]:
        """Return how far each ray goes [m] and the geom it meets, -1: none.

        Args:
            positions: Of the joints [m], world of the motion, (T, J, 3).
            rotations: Of the segments, likewise, (T, J, 4).
            props: Poses of the moving props, MuJoCo's world, each (T, 7).
            eye: Where the rays begin [m], world of the motion, (3,).
            rays: Unit vectors, likewise, (T, N, 3).
        """
        frames, count = rays.shape[:2]
        starts = positions[:, np.maximum(self.skeleton.parents, 0)].copy()
        starts[:, self.skeleton.root] = positions[:, self.skeleton.root]
        place = np.concatenate(
            [to_mujoco(starts), *(p[:, None, :3] for p in props)], axis=1
        )
        turn = np.concatenate(
            [to_mujoco(rotations), *(p[:, None, 3:] for p in props)], axis=1
        )
        point = to_mujoco(eye)
        beams = np.ascontiguousarray(to_mujoco(rays).reshape(frames, -1))
        reach = np.empty((frames, count))
        geoms = np.empty((frames, count), dtype=np.int32)
        model, data = self.model, self.data
        for t in range(frames):
            data.mocap_pos[self._slots] = place[t]
            data.mocap_quat[self._slots] = turn[t]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_multiRay(
                model,
                data,
                point,
                beams[t],
                None,
                True,
                -1,
                geoms[t],
                reach[t],
                None,
                count,
                _FAR,
            )
        return reach, geoms


def _with_body(
    scene: mujoco.MjSpec | None, body: Body, moving: tuple[str, ...]
) -> mujoco.MjSpec:
    if scene is None:
        spec = mujoco.MjSpec()
        floor = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name="floor", type=floor, size=[0.0, 0.0, 1.0])
    else:
        spec = scene.copy()
    for name in moving:
        prop = spec.body(name)
        if prop is None or prop.parent != spec.worldbody:
            raise InputError(
                f"the scene has no prop {name!r} among the children of its world; "
                "it has " + ", ".join(b.name for b in spec.worldbody.bodies)
            )
        for joint in list(prop.joints):
            spec.delete(joint)
        prop.mocap = True
    _add_parts(spec, body)
    return spec


def _add_parts(spec: mujoco.MjSpec, body: Body) -> None:
    """Add one body a segment that can be put anywhere, with the capsules it has."""
    offsets = to_mujoco(body.rest_offsets)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    for j, joint in enumerate(body.skeleton.joints):
        part = spec.worldbody.add_body(name=_PREFIX + joint, mocap=True)
        for side in _flanks(body, j):
            aside = np.array([0.0, side, 0.0])
            end = offsets[j] + 1e-6 * (j == body.skeleton.root)
            part.add_geom(
                type=capsule,
                fromto=[*aside, *(end + aside)],
                size=[body.radii[j], 0.0, 0.0],
            )


def _flanks(body: Body, j: int) -> tuple[float, ...]:
    """Sideways places [m] of a segment's capsules: a trunk is wider than deep."""
    joint = body.skeleton.joints[j]
    if joint not in TRUNK:
        return (0.0,)
    breadth = _HIP_BREADTH if j == body.skeleton.root else _CHEST_BREADTH
    half = max(0.0, 0.5 * breadth * body.height - float(body.radii[j]))
    return (half, -half)
