"""A body in a scene, posed frame by frame, and rays cast into it from a sensor.

Each segment is a MuJoCo mocap body with the segment's capsules.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco

_CHEST_BREADTH = 0.174  # of stature (Drillis & Contini 1966 in Winter 2009, fig. 4.1)
_HIP_BREADTH = 0.191
_TRUNK = ("Spine", "HipCenter", "ShoulderCenter")  # starts of the trunk's joints
_FAR = 20.0  # m: beyond any Kinect's range
_PREFIX = "seen:"  # keeps the names of segments apart from those of the scene


class PosedBody:
    """A body in a scene, z up as in MuJoCo, by default a bare floor, with moving props.

    Raises an InputError if a moving prop is not a direct child of the worldbody.
    """

    def __init__(
        self, body: Body, scene: mujoco.MjSpec | None = None, moving: Sequence[str] = ()
    ) -> None:
        self.body = body
        self.model = _with_body(scene, body, moving).compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        names = [_PREFIX + j for j in body.skeleton.joints] + list(moving)
        ids = [self.model.body(name).id for name in names]
        self._slots = self.model.body_mocapid[ids]
        owner = {i: j for j, i in enumerate(ids[: len(body.skeleton)])}
        owners = [owner.get(b, -1) for b in self.model.geom_bodyid]
        self.segment_of_geom = np.array([*owners, -1])
        """Segment of each geom, -1 for geoms of the scene; the last entry, which geom
        -1 refers to, is also -1."""

    def cast(
        self,
        positions: Array,
        rotations: Array,
        props: list[Array],
        eye: Array,
        rays: Array,
    ) -> tuple[Array, NDArray[np.int32]]:
        """Return each ray's length [m] and the geom it hits, -1 for none, (T, N).

        Joints [m] (T, J, 3), segment rotations (T, J, 4), the rays' origin [m] (3,) and
        unit vectors (T, N, 3) are in the motion's world, props (T, 7) in MuJoCo's.
        """
        frames, count = rays.shape[:2]
        skeleton = self.body.skeleton
        starts = positions[:, np.maximum(skeleton.parents, 0)].copy()
        starts[:, skeleton.root] = positions[:, skeleton.root]
        places = [to_mujoco(starts), *(p[:, None, :3] for p in props)]
        turns = [to_mujoco(rotations), *(p[:, None, 3:] for p in props)]
        place, turn = np.concatenate(places, axis=1), np.concatenate(turns, axis=1)
        eye = to_mujoco(eye)
        beams = np.ascontiguousarray(to_mujoco(rays).reshape(frames, -1))
        reach = np.empty((frames, count))
        geoms = np.empty((frames, count), dtype=np.int32)
        model, data = self.model, self.data
        every = (None, True, -1)  # of all groups, static ones too, of all bodies
        for t in range(frames):
            data.mocap_pos[self._slots] = place[t]
            data.mocap_quat[self._slots] = turn[t]
            mujoco.mj_kinematics(model, data)
            hits = (geoms[t], reach[t], None)  # without normals
            mujoco.mj_multiRay(model, data, eye, beams[t], *every, *hits, count, _FAR)
        return reach, geoms


def _with_body(
    scene: mujoco.MjSpec | None, body: Body, moving: Sequence[str]
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
                f"the scene has no prop {name!r} directly under its worldbody; "
                "it has " + ", ".join(b.name for b in spec.worldbody.bodies)
            )
        for joint in list(prop.joints):
            spec.delete(joint)
        prop.mocap = True
    capsule, offsets = mujoco.mjtGeom.mjGEOM_CAPSULE, to_mujoco(body.rest_offsets)
    for j, joint in enumerate(body.skeleton.joints):
        part = spec.worldbody.add_body(name=_PREFIX + joint, mocap=True)
        end = offsets[j] + 1e-6 * (j == body.skeleton.root)
        for side in _capsule_sides(body, j):
            aside = np.array([0.0, side, 0.0])
            size = [body.radii[j], 0.0, 0.0]
            part.add_geom(type=capsule, fromto=[*aside, *(end + aside)], size=size)
    return spec


def _capsule_sides(body: Body, j: int) -> tuple[float, ...]:
    """Sideways offsets [m] of a segment's capsules: a trunk is wider than deep."""
    if not body.skeleton.joints[j].startswith(_TRUNK):
        return (0.0,)
    breadth = _HIP_BREADTH if j == body.skeleton.root else _CHEST_BREADTH
    half = max(0.0, 0.5 * breadth * body.height - float(body.radii[j]))
    return (half, -half)
