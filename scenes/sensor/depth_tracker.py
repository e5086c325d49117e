"""Depth images, and a tracker that finds joints in them, so that no error is modeled.

Shotton et al. 2011, Real-time human pose recognition in parts from single depth images,
CVPR: a forest classifies pixels by body part (``BodyPartForest``), mean shift finds
where a part's skin is densest, and the joint lies a learned distance behind it. Two
rules, chosen on s02, s03 and s04 of UI-PRMD, keep left and right apart: candidates near
the joint's place in the previous image are preferred, and segments do not stretch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from os import PathLike
from typing import IO, NamedTuple, Self

import mujoco
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from kinefilter.characters import KINECT_V2, SKELETONS, Body, Motion, Skeleton, State
from kinefilter.characters.arrays import Array, Codes, Flags, Indices, Singles

from .geometry import Sensor, in_sensor_frame, in_world_frame, sensor_axes
from .tracker_errors import V1_NAMES
from .visibility import PosedBody, own_parts

BACKGROUND = 10.0  # m: pixels without a person (Shotton 2011: a large constant)
_EVERY = 2  # step between rendered pixels, along rows and columns
_AROUND = 0.3  # m: no skin is farther from every joint
_REACH = 0.04  # of stature: extent of a joint's skin along a limb, a guess
_EDGE = 0.1  # m of depth between neighboring pixels on either side of an edge
_LOST = 0.5  # share of pixels at edges that have no depth, a guess
_TIME_STEP, _DISPARITY_STEP = 0.001, 0.0027  # m, 1/m: steps of depth
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """An image of a person, with rows from the top, columns from the sensor's left."""

    depth: Array  # along the z axis [m], BACKGROUND without a person, (H, W)
    segments: Indices  # index of the visible segment, -1 without a person, (H, W)
    focal: float  # focal length [pixels of this image]

    def rays(self, rows: Indices, columns: Indices) -> Array:
        """Return rays through pixels, in the sensor frame, scaled to z = 1, (N, 3)."""
        height, width = self.depth.shape
        x = (0.5 * (width - 1) - columns) / self.focal
        y = (0.5 * (height - 1) - rows) / self.focal
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def points(self, rows: Indices, columns: Indices) -> Array:
        """Return the points [m] that pixels show, in the sensor frame, (N, 3)."""
        return np.asarray(self.depth[rows, columns][:, None] * self.rays(rows, columns))


class DepthCamera:
    """A sensor that takes depth images of a body in a scene.

    A MuJoCo ray goes through every second pixel of every second row, which needs no
    OpenGL. Everything except the person is removed, as Kinect's trackers do.
    """

    def __init__(self, posed: PosedBody, sensor: Sensor) -> None:
        self._posed = posed
        self.look_from(sensor)

    def look_from(self, sensor: Sensor) -> None:
        """Switch to another sensor or placement."""
        self.sensor = sensor
        self._shape = (sensor.resolution[1] // _EVERY, sensor.resolution[0] // _EVERY)
        wide = 2.0 * float(np.tan(0.5 * sensor.field_of_view[0]))
        self._focal = self._shape[1] / wide
        self._eye, self._axes = in_world_frame(np.zeros(3), sensor), sensor_axes(sensor)

    def take(
        self, positions: Array, rotations: Array, props: Sequence[Array] = ()
    ) -> DepthImage:
        """Return the noiseless image of one frame of ``PosedBody.cast``."""
        empty = np.full(self._shape, BACKGROUND)
        image = DepthImage(empty, np.full(self._shape, -1), self._focal)
        rows, columns = self._box(in_sensor_frame(positions, self.sensor))
        if not len(rows):
            return image
        rays = image.rays(rows, columns)
        length = np.linalg.norm(rays, axis=1)
        reach, geoms = self._posed.cast(
            positions[None],
            rotations[None],
            [pose[None] for pose in props],
            self._eye,
            (rays / length[:, None] @ self._axes)[None],
        )
        segments, depth = self._posed.segment_of_geom[geoms[0]], reach[0] / length
        near, far = self.sensor.depth_range
        visible = (segments >= 0) & (depth > near) & (depth < far)
        pixels = rows[visible], columns[visible]
        image.depth[pixels], image.segments[pixels] = depth[visible], segments[visible]
        return image

    def _box(self, joints: Array) -> tuple[Indices, Indices]:
        x, y, z = joints[joints[:, 2] > self.sensor.depth_range[0]].T
        spans = []
        for place, count in zip((-y, -x), self._shape, strict=True):
            middle = 0.5 * (count - 1)
            low = np.min((place - _AROUND) / z, initial=np.inf) * self._focal + middle
            high = np.max((place + _AROUND) / z, initial=-np.inf) * self._focal + middle
            first, last = np.clip([low, high], -1, count) if len(z) else (0, -1)
            spans.append(np.arange(max(int(first), 0), min(int(last) + 1, count)))
        rows, columns = np.meshgrid(*spans, indexing="ij")
        return rows.ravel(), columns.ravel()


def with_noise(image: DepthImage, sensor: Sensor, rng: Generator) -> DepthImage:
    """Return an image with a Kinect's noise and edges (Khoshelham & Elberink 2012)."""
    depth = image.depth
    edge = maximum_filter(depth, footprint=_CROSS) - depth > _EDGE
    edge |= depth - minimum_filter(depth, footprint=_CROSS) > _EDGE
    kept = ~(edge & (rng.random(depth.shape) < _LOST)) & (image.segments >= 0)
    step = _DISPARITY_STEP * depth**2 if sensor.structured_light else _TIME_STEP
    noisy = depth + sensor.depth_noise.at(depth) * rng.normal(size=depth.shape)
    noisy = np.where(kept, np.round(noisy / step) * step, BACKGROUND)
    return DepthImage(noisy, np.where(kept, image.segments, -1), image.focal)


def nearest_joints(
    points: Array, segments: Indices, positions: Array, body: Body
) -> Indices:
    """Return the joint whose skin each point belongs to, -1 for none, (N,).

    This is the nearest of the joints seen on the point's segment: its two ends or, on
    the trunk, all joints of the trunk. The middle of a limb's segment belongs to none,
    as a joint's skin extends equally far in both directions. Points on the skin (N, 3),
    of ``segments`` (N,), and joint positions (J, 3) are in the same frame [m].
    """
    own = own_parts(body.skeleton)
    distance = np.linalg.norm(points[:, None] - positions, axis=-1)
    distance[~own[:, segments].T] = np.inf
    reach = np.hypot(body.radii, _REACH * body.height)
    reach[own.sum(axis=0) > 2] = np.inf  # the trunk
    far = distance.min(axis=1, initial=np.inf) > reach[segments]
    return np.where(far, -1, np.argmin(distance, axis=1))


BODY_PARTS = (*KINECT_V2.joints, "between")
"""Names of the body parts, after the joints at their centers; the last one is skin
between joints."""
_SAMPLES = 64  # points of skin that represent a body part
_STARTS = 8  # of them from which mean shift starts
_ITERATIONS = 10
_WIDTH = 0.06  # m: standard deviation of the kernel, about that of a hand
_STEP, _LEAPS = 0.15, 0.1  # m between images that a joint moves; share of larger moves
_STRETCH = 1.4  # times its usual length that a segment may measure
_LEAST_PIXELS = 50  # that show a person; fewer are no person, a guess


def depth_differences(
    image: DepthImage, rows: Indices, columns: Indices, offsets: Array
) -> Singles:
    """Return depth differences [m] around pixels (Shotton et al., eq. 1), (N,).

    For a pixel x of depth d(x), the difference is that between the pixels at
    x + u / d(x) and x + v / d(x), the same places on the body at any distance.
    ``offsets`` (N, 2, 2) are u and v of each pixel [m across the view], each as row and
    column.
    """
    depth = np.pad(image.depth.astype(np.float32), 1, constant_values=BACKGROUND)
    scale = np.float32(image.focal) / depth[rows + 1, columns + 1]
    depths = []
    for offset in (offsets[:, 0], offsets[:, 1]):
        row = np.rint(rows + 1 + scale * offset[:, 0]).astype(np.intp)
        column = np.rint(columns + 1 + scale * offset[:, 1]).astype(np.intp)
        np.clip(row, 0, depth.shape[0] - 1, out=row)
        np.clip(column, 0, depth.shape[1] - 1, out=column)
        depths.append(depth[row, column])
    return np.asarray(depths[0] - depths[1])


@dataclass(frozen=True, eq=False)
class BodyPartForest:
    """A forest that classifies pixels by body part, its nodes numbered across trees."""

    offsets: Singles  # u and v of each feature [m across the view], (F, 2, 2)
    roots: NDArray[np.int32]  # root node of each tree, (T,)
    feature: NDArray[np.int16]  # feature that each node tests, -1 for a leaf, (N,)
    threshold: Singles  # largest difference [m] for going on to the left, (N,)
    children: NDArray[np.int32]  # left and right; for a leaf, its row twice, (N, 2)
    leaves: Codes  # share of each body part in a leaf, scaled to 0..255, (L, P)
    push: Singles
    """Depth of a joint behind the skin, along the ray [m], for the joints of Kinect v1
    and v2, by the body part of the same name, (2, P)."""
    least: Singles  # least visible skin [m^2] for it to be tracked, (2, P)

    def shares(self, image: DepthImage, rows: Indices, columns: Indices) -> Array:
        """Return the probability of each body part at pixels, (N, P)."""
        total = np.zeros((len(rows), self.leaves.shape[1]))
        for root in self.roots:
            nodes = np.full(len(rows), root)
            active = np.arange(len(rows))
            while len(active := active[self.feature[nodes[active]] >= 0]):
                at = nodes[active]
                difference = depth_differences(
                    image, rows[active], columns[active], self.offsets[self.feature[at]]
                )
                side = (difference > self.threshold[at]).astype(int)
                nodes[active] = self.children[at, side]
            total += self.leaves[self.children[nodes, 0]]
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def save(self, file: str | PathLike[str] | IO[bytes]) -> None:
        """Write the arrays to a .npz file."""
        np.savez_compressed(file, **vars(self))

    @classmethod
    def load(cls, file: str | PathLike[str] | IO[bytes]) -> Self:
        """Read a file written by ``save``."""
        with np.load(file, allow_pickle=False) as arrays:
            return cls(**{f.name: arrays[f.name] for f in fields(cls)})


@cache
def shipped_forest() -> BodyPartForest:
    """Return the forest that ships with kinefilter."""
    path = resources.files(__package__).joinpath("embedded/body_parts.npz")
    with path.open("rb") as file:
        return BodyPartForest.load(file)


def parts_of_joints(skeleton: Skeleton) -> Flags:
    """Return which body parts belong to each joint or the one beside it, (P, J)."""
    joints = skeleton.joints
    belongs = np.zeros((len(BODY_PARTS), len(joints)), dtype=bool)
    for p, name in enumerate(KINECT_V2.joints):
        kind = KINECT_V2.kinds[p]
        v1_name = V1_NAMES.get(kind, kind) + name.removeprefix(kind)
        belongs[p, joints.index(name if name in joints else v1_name)] = True
    return belongs


class Proposals(NamedTuple):
    """Skin around each joint in one image, in the sensor frame."""

    skin: Array  # where the skin is densest [m], NaN without any, (J, 3)
    area: Array  # area of skin there, weighted by probability [m^2], (J,)


def propose(
    image: DepthImage,
    forest: BodyPartForest,
    skeleton: Skeleton,
    before: Array | None = None,
) -> Proposals:
    """Locate the skin around each joint by mean shift (Shotton et al., eq. 7).

    Every second pixel counts, weighted by its probability and by the area of skin that
    it shows; a sample of points drawn with that weight represents each joint's. Of
    several modes, the one with the most skin wins; those near ``before``, the skin in
    the previous image [m], (J, 3), may have less.
    """
    rows, columns = np.nonzero(image.segments >= 0)
    kept = (rows + columns) % 2 == 0
    rows, columns = rows[kept], columns[kept]
    if len(rows) < _LEAST_PIXELS:
        return Proposals(np.full((len(skeleton), 3), np.nan), np.zeros(len(skeleton)))
    points = image.points(rows, columns)
    shares = forest.shares(image, rows, columns) @ parts_of_joints(skeleton)
    weights = 2.0 * shares * (points[:, 2] / image.focal)[:, None] ** 2
    whole = weights.sum(axis=0)
    # Points of equal weight, at even steps of the cumulative weight.
    ends = np.cumsum(weights, axis=0) / np.maximum(whole, 1e-12)
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    sampled = np.array([np.searchsorted(end, steps) for end in ends.T])
    cloud = points[np.minimum(sampled, len(points) - 1)]  # (J, samples, 3)
    modes = cloud[:, :: _SAMPLES // _STARTS]
    for _ in range(_ITERATIONS):
        near = _kernel(modes, cloud)
        modes = near @ cloud / near.sum(axis=-1, keepdims=True)
    density = likely = _kernel(modes, cloud).mean(axis=-1)
    if before is not None:
        away = np.linalg.norm(modes - before[:, None], axis=-1)
        stayed = np.exp(-0.5 * np.square(np.nan_to_num(away, nan=np.inf) / _STEP))
        likely = density * (_LEAPS + stayed)
    best = np.arange(len(skeleton)), np.argmax(likely, axis=1)
    skin = np.where(whole[:, None] > 0.0, modes[best], np.nan)
    return Proposals(skin, whole * density[best])


def _kernel(modes: Array, cloud: Array) -> Array:
    away = np.square(modes).sum(-1)[..., None] + np.square(cloud).sum(-1)[:, None]
    away -= 2.0 * modes @ cloud.swapaxes(1, 2)
    return np.asarray(np.exp(-0.5 * np.maximum(away, 0.0) / _WIDTH**2))


def track_in_depth(
    motion: Motion,
    sensor: Sensor,
    rng: Generator,
    scene: mujoco.MjSpec | None,
    prop_poses: Mapping[str, Array],
) -> tuple[Array, Codes]:
    """Find joints [m] in the sensor frame, (T, J, 3), and states; see ``observe``."""
    forest, skeleton = shipped_forest(), motion.skeleton
    camera = DepthCamera(PosedBody(motion.body, scene, tuple(prop_poses)), sensor)
    push, least = joint_constants(forest, skeleton)
    positions = np.full(motion.positions.shape, np.nan)
    state = np.full(positions.shape[:2], State.NOT_TRACKED, dtype=np.uint8)
    skin = None
    for t, joints in enumerate(motion.positions):
        props = [poses[t] for poses in prop_poses.values()]
        image = with_noise(camera.take(joints, motion.rotations[t], props), sensor, rng)
        skin, area = propose(image, forest, skeleton, skin)
        if area.any():
            positions[t] = push_behind_skin(skin, push)
            state[t] = np.where(area >= least, State.TRACKED, State.INFERRED)
    return hold_inferred(positions, state, skeleton, sensor), state


def joint_constants(forest: BodyPartForest, skeleton: Skeleton) -> tuple[Array, Array]:
    """Return each joint's depth behind the skin [m] and least area [m^2], (J,) each."""
    row = list(SKELETONS).index(skeleton.name)
    of_joint = np.argmax(parts_of_joints(skeleton), axis=0)
    return forest.push[row, of_joint], forest.least[row, of_joint]


def push_behind_skin(skin: Array, push: Array) -> Array:
    """Return points [m] moved a distance [m] away from the origin."""
    return np.asarray(skin * (1.0 + push / np.linalg.norm(skin, axis=-1))[..., None])


def hold_inferred(
    positions: Array, state: Codes, skeleton: Skeleton, sensor: Sensor
) -> Array:
    """Return joint positions [m] in which inferred joints stay with their parents.

    A joint too far from its parent, compared with the segment's usual length in the
    take, becomes inferred. Joints out of view become not tracked, and NaN. Positions
    (T, J, 3) are in the sensor frame; the states (T, J) are changed in place.
    """
    held = positions.copy()
    parents = np.maximum(skeleton.parents, 0)
    bones = np.linalg.norm(positions - positions[:, parents], axis=-1)
    tracked = (state == State.TRACKED) & (state[:, parents] == State.TRACKED)
    usual = [
        float(np.median(bones[frames, j])) if frames.any() else np.inf
        for j, frames in enumerate(tracked.T)
    ]
    for t in range(1, len(held)):
        for j in skeleton.order:
            before, parent = held[t - 1, j], skeleton.parents[j]
            if parent >= 0:
                before = before + held[t, parent] - held[t - 1, parent]
                if np.linalg.norm(held[t, j] - held[t, parent]) > _STRETCH * usual[j]:
                    state[t, j] = min(state[t, j], State.INFERRED)
            if state[t, j] == State.INFERRED and np.isfinite(before).all():
                held[t, j] = before
    lost = ~sensor.in_view(np.nan_to_num(held)) | np.isnan(held[..., 0])
    state[lost] = State.NOT_TRACKED
    held[lost] = np.nan
    return held
