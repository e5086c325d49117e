"""What a sensor sees of each joint, past the body itself and what stands in the room.

From the sensor, rays go to the neighborhood of every joint: a disk across the line of
sight that the part's own capsule fills, and a ring around it. Whatever a ray of the
disk meets before the part hides it; whatever a ray of the ring meets at the part's own
depth cannot be told from it in a depth image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Motion, Skeleton
from kinefilter.characters.arrays import Array, Flags, chunks
from kinefilter.characters.rotations import IDENTITY

from .geometry import Sensor, in_world_frame, sensor_axes
from .ray_casting import TRUNK, PosedBody, check_prop_poses

_DISK_RAYS = 24
_RING_RAYS = 12
_DISK = 0.8  # of the part's radius: rays at its very edge would miss it by rounding
_RING = 0.04  # m around the part: about five pixels of a Kinect v2 at 2.7 m
_SAME_DEPTH = 0.06  # m: less contrast than a part's own thickness, a guess
_NEAR_PROP = 0.12  # m: a prop nearer to a part than this may be taken for it, a guess
_CHUNK = 1024  # frames, so that an hour's take needs no gigabytes


@dataclass(frozen=True, eq=False)
class Sight:
    """What a sensor sees of each joint; vectors in the world of the motion."""

    visible: Array
    """Share of the part that nothing hides, in [0, 1], shape (T, J)."""
    pull: Array
    """From the center of the part's surface to that of what is seen of it [m], shape
    (T, J, 3); zero where all or nothing is seen."""
    front: Array
    """How much nearer to the sensor the seen surface is than the joint's own radius
    would put it [m]: a limb that points at the sensor, shape (T, J)."""
    merged: Array
    """Share of the surroundings at the part's own depth, in [0, 1], shape (T, J)."""
    rival: Array
    """Share of disk and ring filled by the same part of the other side, (T, J)."""
    prop: Array
    """Share of disk and ring filled by props as near as the part itself, (T, J)."""
    prop_pull: Array
    """From the part's surface to the center of those props' [m], shape (T, J, 3)."""


def look(
    motion: Motion,
    sensor: Sensor,
    *,
    scene: mujoco.MjSpec | None = None,
    prop_poses: Mapping[str, Array] | None = None,
) -> Sight:
    """Return what a sensor sees of a motion.

    Args:
        motion: Joint positions and segment rotations, world frame.
        sensor: Where the sensor stands.
        scene: The room and its props, z up as MuJoCo has it; by default a bare floor.
        prop_poses: For bodies of the scene that move: position [m] and orientation
            wxyz in every frame, MuJoCo's world, shape (T, 7).

    Raises:
        InputError: A moving prop is no body of the scene, not a child of its world,
            or its poses do not fit the motion.
    """
    prop_poses = prop_poses or {}
    check_prop_poses(motion, prop_poses)
    scanner = _Scanner(motion.body, sensor, scene, tuple(prop_poses))
    moving = [np.asarray(poses, float) for poses in prop_poses.values()]
    parts = [
        scanner.scan(motion.positions[c], motion.rotations[c], [p[c] for p in moving])
        for c in chunks(len(motion), _CHUNK)
    ]
    return Sight(
        *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Sight))
    )


def rest_front(body: Body, sensor: Sensor) -> Array:
    """Return ``front`` of a T-pose before a level sensor that it faces [m], (J,)."""
    scanner = _Scanner(body, replace(sensor, azimuth=0.0, tilt=0.0), None, ())
    rotations = np.broadcast_to(IDENTITY, (1, len(body.skeleton), 4))
    return np.asarray(scanner.scan(body.rest_positions[None], rotations, []).front[0])


class _Scanner:
    """A body in a scene before a sensor."""

    def __init__(
        self,
        body: Body,
        sensor: Sensor,
        scene: mujoco.MjSpec | None,
        moving: tuple[str, ...],
    ) -> None:
        self.skeleton = body.skeleton
        self.eye = in_world_frame(np.zeros(3), sensor)
        self.up = sensor_axes(sensor)[1]
        self.posed = PosedBody(body, scene, moving)
        model, part = self.posed.model, self.posed.segment
        flat = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        flat &= model.geom_bodyid == 0
        self.is_prop = (part < 0) & ~np.append(flat, True)
        self.is_hit = np.append(np.ones(model.ngeom, bool), False)
        own = own_parts(body.skeleton)
        self.own = np.where(part >= 0, own[:, part], False)  # (J, geoms + none)
        kin = _kin(body.skeleton)
        self.kin = np.where(part >= 0, kin[:, part], False) | self.own
        self.rival = self.own[body.skeleton.mirror] & ~self.own
        self.rival[body.skeleton.mirror == np.arange(len(own))] = False
        self.radii = _part_radii(body)

    def scan(self, positions: Array, rotations: Array, props: list[Array]) -> Sight:
        """Return what is seen of the postures (T, J, 3) and (T, J, 4)."""
        spots = self._spots(positions)
        rays = spots - self.eye
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        flat = rays.reshape(len(rays), -1, 3)
        reach, geoms = self.posed.cast(positions, rotations, props, self.eye, flat)
        found = self.eye + reach.reshape(rays.shape[:-1])[..., None] * rays
        return self._judge(spots, found, geoms.reshape(rays.shape[:-1]))

    def _spots(self, positions: Array) -> Array:
        """Points [m] that the rays aim at: on the part's front and around it."""
        line = positions - self.eye
        line /= np.linalg.norm(line, axis=-1, keepdims=True)
        right = np.cross(self.up, line)
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        up = np.cross(line, right)
        pattern = _pattern()
        disk = (
            self.radii[:, None] * _DISK * np.linalg.norm(pattern[:_DISK_RAYS], axis=1)
        )
        bulge = np.sqrt(self.radii[:, None] ** 2 - disk**2)
        forward = np.pad(bulge, ((0, 0), (0, _RING_RAYS)))
        wide = np.empty((len(self.radii), len(pattern)))
        wide[:, :_DISK_RAYS] = _DISK * self.radii[:, None]
        wide[:, _DISK_RAYS:] = self.radii[:, None] + _RING
        x, y = wide * pattern[:, 0], wide * pattern[:, 1]
        return np.asarray(
            positions[:, :, None]
            + x[..., None] * right[:, :, None]
            + y[..., None] * up[:, :, None]
            - forward[..., None] * line[:, :, None]
        )

    def _judge(self, spots: Array, found: Array, geoms: NDArray[np.int32]) -> Sight:
        joint = np.arange(len(self.radii))[:, None]
        # A ray that meets nothing has geom -1: the last column of the tables.
        own = self.own[joint, geoms]
        disk = own[..., :_DISK_RAYS]
        there = spots[..., :_DISK_RAYS, :]
        center = there.mean(axis=2)
        seen = np.asarray(disk.any(axis=-1))
        pull = np.where(seen[..., None], _mean_where(there, disk) - center, 0.0)
        far = np.linalg.norm(found - self.eye, axis=-1)
        depth = np.linalg.norm(there - self.eye, axis=-1)
        nearer = (depth - far[..., :_DISK_RAYS])[..., None]
        front = np.where(seen, _mean_where(nearer, disk)[..., 0], 0.0)
        near = np.linalg.norm(found - center[..., None, :], axis=-1)
        apart = np.abs(far - (depth.mean(axis=-1) - front)[..., None])
        hit = self.is_hit[geoms]
        alike = hit & ~self.kin[joint, geoms] & (apart < _SAME_DEPTH)
        rival = self.rival[joint, geoms]
        prop = self.is_prop[geoms] & (near < self.radii[:, None] + _NEAR_PROP)
        away = _mean_where(found, prop) - center
        return Sight(
            visible=disk.mean(axis=-1),
            pull=pull,
            front=front,
            merged=alike[..., _DISK_RAYS:].mean(axis=-1),
            rival=rival.mean(axis=-1),
            prop=prop.mean(axis=-1),
            prop_pull=np.where(prop.any(axis=-1)[..., None], away, 0.0),
        )


def _mean_where(values: Array, mask: Flags) -> Array:
    """Mean of vectors (..., N, 3) over the N that a mask keeps, 0 where none."""
    count = np.maximum(mask.sum(axis=-1), 1)
    total = np.einsum("...nk,...n->...k", values, mask.astype(float))
    return np.asarray(total / count[..., None])


def _pattern() -> Array:
    """Return unit-disk points that fill a disk evenly (Vogel 1979), then a ring."""
    k = np.arange(_DISK_RAYS)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * k
    radius = np.sqrt((k + 0.5) / _DISK_RAYS)
    disk = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around = 2.0 * np.pi * (np.arange(_RING_RAYS) + 0.5) / _RING_RAYS
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    # An even filling of few points is not quite centered.
    return np.concatenate([disk - disk.mean(axis=0), ring])


def own_parts(skeleton: Skeleton) -> Flags:
    """Return which segments a joint is seen on, shape (joint J, segment J).

    The two that meet there; a joint of the trunk is seen on all of the trunk.
    """
    own = np.eye(len(skeleton), dtype=bool)
    for j, children in enumerate(skeleton.children):
        own[j, list(children)] = True
    names = (*TRUNK, "Neck")
    trunk = [
        j
        for j, name in enumerate(skeleton.joints)
        if name in names or name.startswith(("Hip", "Shoulder"))
    ]
    own[np.ix_(trunk, trunk)] = True
    return own


def _kin(skeleton: Skeleton) -> Flags:
    """Return which segments are next to a joint's own along the limb, (J, J)."""
    kin = np.zeros((len(skeleton), len(skeleton)), dtype=bool)
    kin[skeleton.segments, skeleton.segment_parents] = True
    return kin | kin.T


def _part_radii(body: Body) -> Array:
    """Return the radius [m] that the part around each joint shows, shape (J,).

    The thinner of the two segments that meet there, so that the disk is filled.
    """
    radii = body.radii.copy()
    for j, children in enumerate(body.skeleton.children):
        radii[j] = min(radii[j], *(body.radii[c] for c in children), np.inf)
    return radii
