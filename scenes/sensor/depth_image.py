"""The depth image that a Kinect takes of a person, and the joint each pixel shows.

A MuJoCo ray goes through every second pixel of every second row, which needs no OpenGL.
Everything except the person is removed, as Kinect's trackers do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.ndimage import maximum_filter, minimum_filter

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Indices

from .geometry import Sensor, in_sensor_frame, in_world_frame, sensor_axes
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
    """A sensor that takes depth images of a body in a scene."""

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
