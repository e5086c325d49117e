"""The depth image that a Kinect takes of a person, and which joint each pixel shows.

One of MuJoCo's rays goes through every second pixel of every second row: the same as
drawing, without OpenGL. What is no person is taken out of the image, as Kinect's
trackers do before they look for joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Indices

from .geometry import Sensor, in_sensor_frame, in_world_frame, sensor_axes
from .ray_casting import PosedBody
from .visibility import own_parts

BACKGROUND = 10.0
"""Depth [m] of pixels that show nobody (Shotton et al. 2011: a large constant)."""
_EVERY = 2  # pixel of a row or column is looked at
_AROUND = 0.3  # m: no flesh is farther from every joint
_REACH = 0.04  # of stature: how far skin along a limb is around a joint, a guess
_EDGE = 0.1  # m between neighboring pixels: what is farther apart is an edge
_LOST = 0.5  # share of pixels at edges that have no depth, a guess
_WHOLE, _DISPARITY = 0.001, 0.0027  # m, 1/m: steps of depth
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What a sensor sees of a person; the highest row first, left as the sensor's."""

    depth: Array
    """Distance [m] along the sensor's z axis, BACKGROUND where nobody is, (H, W)."""
    segments: Indices
    """Index of the segment that is seen, -1 where nobody is, (H, W)."""
    focal: float
    """Focal length in pixels of this image."""

    def points(self, rows: Indices, columns: Indices) -> Array:
        """Return where pixels (N,) see something [m], in the sensor's frame, (N, 3)."""
        height, width = self.depth.shape
        x = (0.5 * (width - 1) - columns) / self.focal
        y = (0.5 * (height - 1) - rows) / self.focal
        ray = np.stack([x, y, np.ones_like(x)], axis=-1)
        return np.asarray(self.depth[rows, columns][:, None] * ray)


class DepthCamera:
    """A sensor before a body in a scene.

    Args:
        posed: The body, and what is around it.
        sensor: Where it stands, and what its lens and range allow.
    """

    def __init__(self, posed: PosedBody, sensor: Sensor) -> None:
        self._posed = posed
        self.look_from(sensor)

    def look_from(self, sensor: Sensor) -> None:
        """Look through another sensor, or from another place, from now on."""
        self.sensor = sensor
        self._shape = (sensor.resolution[1] // _EVERY, sensor.resolution[0] // _EVERY)
        wide = 2.0 * float(np.tan(0.5 * sensor.field_of_view[0]))
        self._focal = self._shape[1] / wide
        self._eye, self._axes = in_world_frame(np.zeros(3), sensor), sensor_axes(sensor)

    def take(
        self, positions: Array, rotations: Array, props: Sequence[Array] = ()
    ) -> DepthImage:
        """Return the image of a posture, without any noise.

        Args:
            positions: Of the joints [m], world of the motion, (J, 3).
            rotations: Of the segments, likewise, (J, 4).
            props: Poses of the moving props, MuJoCo's world, each (7,).
        """
        empty = np.full(self._shape, BACKGROUND)
        image = DepthImage(empty, np.full(self._shape, -1), self._focal)
        rows, columns = self._box(in_sensor_frame(positions, self.sensor))
        if not len(rows):
            return image
        empty[rows, columns] = 1.0
        rays = image.points(rows, columns)
        empty[rows, columns] = BACKGROUND
        size = np.linalg.norm(rays, axis=1)
        reach, geoms = self._posed.cast(
            positions[None],
            rotations[None],
            [pose[None] for pose in props],
            self._eye,
            (rays / size[:, None] @ self._axes)[None],
        )
        segments, depth = self._posed.segment[geoms[0]], reach[0] / size
        near, far = self.sensor.depth_range
        seen = (segments >= 0) & (depth > near) & (depth < far)
        image.depth[rows[seen], columns[seen]] = depth[seen]
        image.segments[rows[seen], columns[seen]] = segments[seen]
        return image

    def _box(self, joints: Array) -> tuple[Indices, Indices]:
        """Return rows and columns of the pixels around the joints [m], (N,) each."""
        x, y, z = joints[joints[:, 2] > self.sensor.depth_range[0]].T
        spans = []
        for place, count in zip((-y, -x), self._shape, strict=True):
            middle, around = 0.5 * (count - 1), _AROUND
            low = np.min((place - around) / z, initial=np.inf) * self._focal + middle
            high = np.max((place + around) / z, initial=-np.inf) * self._focal + middle
            first, last = np.clip([low, high], -1, count) if len(z) else (0, -1)
            spans.append(np.arange(max(int(first), 0), min(int(last) + 1, count)))
        rows, columns = np.meshgrid(*spans, indexing="ij")
        return rows.ravel(), columns.ravel()


def with_noise(
    image: DepthImage, sensor: Sensor, rng: np.random.Generator
) -> DepthImage:
    """Return an image as a Kinect has it: noise, whole steps of depth, lost edges.

    An eighth of a pixel of disparity is 2.7 mm times the squared depth in meters
    (Khoshelham & Elberink 2012, Sensors 12(2)).
    """
    depth, noise = image.depth, sensor.depth_noise
    edge = maximum_filter(depth, footprint=_CROSS) - depth > _EDGE
    edge |= depth - minimum_filter(depth, footprint=_CROSS) > _EDGE
    there = image.segments >= 0
    there &= ~(edge & (rng.random(depth.shape) < _LOST))
    step = _DISPARITY * depth**2 if sensor.structured_light else _WHOLE
    noisy = depth + noise.at(depth) * rng.normal(size=depth.shape)
    noisy = np.round(noisy / step) * step
    return DepthImage(
        np.where(there, noisy, BACKGROUND),
        np.where(there, image.segments, -1),
        image.focal,
    )


def nearest_joints(
    points: Array, segments: Indices, positions: Array, body: Body
) -> Indices:
    """Return the joint that each point of the skin is around, -1: none, (N,).

    The nearest of those that are seen on its segment: its two ends or, on the trunk,
    all joints of the trunk. In the middle of a limb's segment is none: what is around
    a joint reaches as far up as down, whatever the lengths of the two segments.

    Args:
        points: On the skin [m], in any frame, (N, 3).
        segments: Whose skin it is, (N,).
        positions: Of the joints [m], in the same frame, (J, 3).
        body: Whose segments they are.
    """
    own = own_parts(body.skeleton)
    away = np.linalg.norm(points[:, None] - positions, axis=-1)
    away[~own[:, segments].T] = np.inf
    reach = np.hypot(body.radii, _REACH * body.height)
    reach[own.sum(axis=0) > 2] = np.inf  # the trunk
    far = away.min(axis=1, initial=np.inf) > reach[segments]
    return np.where(far, -1, np.argmin(away, axis=1))
