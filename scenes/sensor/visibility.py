"""How much of each joint a sensor sees past the body itself, props and the room.

Rays go to a disk across the line of sight to every joint, filled by the part's own
capsule, and to a ring around it. Whatever a ray of the disk hits before the part hides
the part; whatever a ray of the ring hits at the part's depth cannot be told apart. They
are cast into a scene with the body, each of whose segments is a MuJoCo mocap body with
the segment's capsules.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, InputError, Motion, Skeleton
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import IDENTITY, unit

from .geometry import Sensor, in_world_frame, sensor_axes

_CHEST_BREADTH = 0.174  # of stature (Drillis & Contini 1966 in Winter 2009, fig. 4.1)
_HIP_BREADTH = 0.191
_TRUNK = ("Spine", "HipCenter", "ShoulderCenter")  # starts of the trunk's joints
_FAR = 20.0  # m: beyond any Kinect's range
_PREFIX = "seen:"  # keeps the names of segments apart from those of the scene
_DISK_RAYS = 24
_RING_RAYS = 12
_DISK = 0.8  # of the part's radius: rays at the very edge would miss by rounding
_RING = 0.04  # m around the part: about five pixels of a Kinect v2 at 2.7 m
_SAME_DEPTH = 0.06  # m: less contrast than a part's own thickness, a guess
_NEAR_PROP = 0.12  # m: a prop nearer to a part may be mistaken for it, a guess
_CHUNK = 1024  # frames, to bound the memory for long takes


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


@dataclass(frozen=True, eq=False)
class Sight:
    """How much of each joint a sensor sees; vectors are in the motion's world."""

    visible: Array  # share of the part that nothing hides, in [0, 1], shape (T, J)
    pull: Array  # from the part's to its visible surface's center [m], (T, J, 3)
    front: Array
    """How much nearer to the sensor the visible surface is than the joint's own radius
    implies [m], large for a limb that points at the sensor, shape (T, J)."""
    merged: Array  # share of the surroundings at the part's depth, (T, J)
    rival: Array  # share of rays that hit the other side's same part, (T, J)
    prop: Array  # share of rays that hit props about as near as the part, (T, J)
    prop_pull: Array  # vector to those props' surfaces [m], (T, J, 3)


def look(
    motion: Motion,
    sensor: Sensor,
    *,
    scene: mujoco.MjSpec | None = None,
    prop_poses: Mapping[str, Array] | None = None,
) -> Sight:
    """Return how much of each joint a sensor sees; for the rest see ``observe``."""
    props = prop_poses or {}
    scanner = _Scanner(PosedBody(motion.body, scene, tuple(props)), sensor)
    moving = props.values()
    parts = [
        scanner.scan(motion.positions[c], motion.rotations[c], [p[c] for p in moving])
        for c in chunks(len(motion), _CHUNK)
    ]
    names = [field.name for field in fields(Sight)]
    return Sight(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def rest_front(body: Body, sensor: Sensor) -> Array:
    """Return ``Sight.front`` of a T-pose facing the sensor, without tilt [m], (J,)."""
    scanner = _Scanner(PosedBody(body), replace(sensor, azimuth=0.0, tilt=0.0))
    rotations = np.broadcast_to(IDENTITY, (1, len(body.skeleton), 4))
    return np.asarray(scanner.scan(body.rest_positions[None], rotations, []).front[0])


class _Scanner:
    """A body in a scene, scanned by a sensor."""

    def __init__(self, posed: PosedBody, sensor: Sensor) -> None:
        skeleton, radii = posed.body.skeleton, posed.body.radii
        self.posed = posed
        self.eye = in_world_frame(np.zeros(3), sensor)
        self.up = sensor_axes(sensor)[1]
        model, segment = posed.model, posed.segment_of_geom
        flat = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        flat &= model.geom_bodyid == 0
        # Tables over geoms have one more column, for geom -1: a ray that hits nothing.
        self.is_prop = (segment < 0) & ~np.append(flat, True)
        own = own_parts(skeleton)
        self.own = own[:, segment] & (segment >= 0)  # (J, geoms + 1)
        adjacent = np.zeros_like(own)
        adjacent[skeleton.segments, skeleton.segment_parents] = True
        adjacent |= adjacent.T
        self.near_own = adjacent[:, segment] & (segment >= 0) | self.own
        self.rival = self.own[skeleton.mirror] & ~self.own
        self.rival[skeleton.mirror == np.arange(len(own))] = False
        # A part is as thin as the thinner of its segments, so that it fills the disk.
        parts = [[j, *children] for j, children in enumerate(skeleton.children)]
        self.radii = np.array([radii[part].min() for part in parts])

    def scan(self, positions: Array, rotations: Array, props: list[Array]) -> Sight:
        """Return the sight of postures (T, J, 3) [m] and (T, J, 4)."""
        targets = self._targets(positions)
        rays = unit(targets - self.eye)
        flat = rays.reshape(len(rays), -1, 3)
        reach, geoms = self.posed.cast(positions, rotations, props, self.eye, flat)
        hits = self.eye + reach.reshape(rays.shape[:-1])[..., None] * rays
        return self._judge(targets, hits, geoms.reshape(rays.shape[:-1]))

    def _targets(self, positions: Array) -> Array:
        """Points [m] that rays aim at, on each part's front and around it."""
        line = unit(positions - self.eye)
        right = unit(np.cross(self.up, line))
        up = np.cross(line, right)
        pattern = _pattern()
        radii = self.radii[:, None]
        sizes = np.hstack([_DISK * radii, radii + _RING])
        scale = np.repeat(sizes, [_DISK_RAYS, _RING_RAYS], axis=1)
        disk = scale[:, :_DISK_RAYS] * np.linalg.norm(pattern[:_DISK_RAYS], axis=1)
        bulge = np.pad(np.sqrt(radii**2 - disk**2), ((0, 0), (0, _RING_RAYS)))
        x, y = scale * pattern[:, 0], scale * pattern[:, 1]
        return np.asarray(
            positions[:, :, None]
            + x[..., None] * right[:, :, None]
            + y[..., None] * up[:, :, None]
            - bulge[..., None] * line[:, :, None]
        )

    def _judge(self, targets: Array, hits: Array, geoms: NDArray[np.int32]) -> Sight:
        joint = np.arange(len(self.radii))[:, None]
        disk = self.own[joint, geoms][..., :_DISK_RAYS]
        surface = targets[..., :_DISK_RAYS, :]
        center = surface.mean(axis=2)
        visible = np.asarray(disk.any(axis=-1))
        pull = np.where(visible[..., None], _mean_where(surface, disk) - center, 0.0)
        distance = np.linalg.norm(hits - self.eye, axis=-1)
        depth = np.linalg.norm(surface - self.eye, axis=-1)
        nearer = (depth - distance[..., :_DISK_RAYS])[..., None]
        front = np.where(visible, _mean_where(nearer, disk)[..., 0], 0.0)
        contrast = np.abs(distance - (depth.mean(axis=-1) - front)[..., None])
        foreign = (geoms >= 0) & ~self.near_own[joint, geoms]
        alike = foreign & (contrast < _SAME_DEPTH)
        near = np.linalg.norm(hits - center[..., None, :], axis=-1)
        prop = self.is_prop[geoms] & (near < self.radii[:, None] + _NEAR_PROP)
        away = _mean_where(hits, prop) - center
        return Sight(
            visible=disk.mean(axis=-1),
            pull=pull,
            front=front,
            merged=alike[..., _DISK_RAYS:].mean(axis=-1),
            rival=self.rival[joint, geoms].mean(axis=-1),
            prop=prop.mean(axis=-1),
            prop_pull=np.where(prop.any(axis=-1)[..., None], away, 0.0),
        )


def _mean_where(values: Array, mask: Flags) -> Array:
    """Mean of the vectors (..., N, 3) that a mask keeps, zero if there are none."""
    count = np.maximum(mask.sum(axis=-1), 1)
    total = np.einsum("...nk,...n->...k", values, mask.astype(float))
    return np.asarray(total / count[..., None])


def _pattern() -> Array:
    k = np.arange(_DISK_RAYS)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * k
    radius = np.sqrt((k + 0.5) / _DISK_RAYS)
    disk = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around = 2.0 * np.pi * (np.arange(_RING_RAYS) + 0.5) / _RING_RAYS
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    # So few points are not quite centered.
    return np.concatenate([disk - disk.mean(axis=0), ring])


def own_parts(skeleton: Skeleton) -> Flags:
    """Return which segments meet at each joint, or form its trunk, (J, J)."""
    own = np.eye(len(skeleton), dtype=bool)
    for j, children in enumerate(skeleton.children):
        own[j, list(children)] = True
    starts = ("Spine", "Neck", "Hip", "Shoulder")
    trunk = [j for j, name in enumerate(skeleton.joints) if name.startswith(starts)]
    own[np.ix_(trunk, trunk)] = True
    return own
