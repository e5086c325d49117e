"""Placement, optics and clock of the virtual Kinect.

Sensor frame: origin at the sensor, y up, z from the sensor toward the person, x to the
sensor's left. A person facing the sensor faces -z.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import about_x, about_y, inverse, multiply, rotate


class DepthNoise(NamedTuple):
    """Standard deviation [m] of a depth z: constant + linear z + quadratic z^2."""

    constant: float
    linear: float
    quadratic: float

    def at(self, depth: Array) -> Array:
        """Return the standard deviation [m] at depths [m]."""
        constant, linear, quadratic = self
        return np.asarray(constant + linear * depth + quadratic * depth**2)


_V2_NOISE = DepthNoise(0.0015, -0.0005, 0.0003)


@dataclass(frozen=True)
class Sensor:
    """Placement, optics and clock of one Kinect. The defaults describe a Kinect v2."""

    height: float = 1.0  # height of the sensor above the floor [m]
    distance: float = 2.7  # from the sensor to the world's origin, on the floor [m]
    azimuth: float = 0.0  # of the performer to the left, 0 facing the sensor [rad]
    tilt: float = 0.0  # pitch of the sensor, positive upward [rad]
    field_of_view: tuple[float, float] = (np.radians(70.6), np.radians(60.0))
    """Horizontal and vertical angle of view [rad]."""
    resolution: tuple[int, int] = (512, 424)  # columns and rows of the depth image
    depth_range: tuple[float, float] = (0.5, 4.5)  # smallest and largest [m]
    depth_noise: DepthNoise = _V2_NOISE
    """Noise of a pixel's depth, by default at normal incidence (Fankhauser et al. 2015,
    Kinect v2 for mobile robot navigation)."""
    structured_light: bool = False  # depth in steps of 1/8 pixel, not of 1 mm
    dropped_share: float = 0.014  # of frames; in labanotation takes 0.5 to 2.9 %
    stamp_jitter: float = 0.0003  # deviation [s], from labanotation takes

    def pixels(self, depth: Array) -> Array:
        """Return the pixel density [1/m^2] on a plane across the view at depths [m]."""
        columns, rows = self.resolution
        wide, high = (2.0 * np.tan(angle / 2.0) for angle in self.field_of_view)
        return np.asarray(columns * rows / (wide * high * depth**2))

    def in_view(self, positions: Array) -> Flags:
        """Return True for points (..., 3) [m], sensor frame, in view and in range."""
        x, y, z = np.moveaxis(positions, -1, 0)
        near, far = self.depth_range
        wide, high = (np.tan(angle / 2.0) for angle in self.field_of_view)
        inside = (np.abs(x) < wide * z) & (np.abs(y) < high * z)
        return np.asarray(inside & (near < z) & (z < far))


SENSORS = {
    "v1": Sensor(
        field_of_view=(np.radians(57.0), np.radians(43.0)),
        resolution=(640, 480),
        depth_range=(0.8, 4.0),
        depth_noise=DepthNoise(0.0, 0.0, 0.00143),
        structured_light=True,
    ),
    "v2": Sensor(),
    "azure": Sensor(
        field_of_view=(np.radians(75.0), np.radians(65.0)),
        resolution=(640, 576),
        depth_range=(0.5, 3.86),
        depth_noise=DepthNoise(0.0006, 0.0, 0.0001),
    ),
}
"""Kinect models, with geometry from their data sheets.

The depth noise of v1 is that of triangulation (Khoshelham & Elberink 2012, Sensors
12(2)); that of azure is a guess, 1 to 2 mm within its range.
"""


def _view(sensor: Sensor) -> tuple[Array, Array, Array]:
    """Return the yaw, offset [m] and tilt from the world to the sensor frame."""
    offset = np.array([0.0, -sensor.height, sensor.distance])
    return about_y(np.pi + sensor.azimuth), offset, about_x(sensor.tilt)


def in_sensor_frame(positions: Array, sensor: Sensor) -> Array:
    """Transform positions (..., 3) [m] from the motion's world to the sensor frame."""
    yaw, offset, tilt = _view(sensor)
    return rotate(tilt, rotate(yaw, positions) + offset)


def in_world_frame(positions: Array, sensor: Sensor) -> Array:
    """Transform positions (..., 3) [m] from the sensor frame to the motion's world."""
    yaw, offset, tilt = _view(sensor)
    return rotate(inverse(yaw), rotate(inverse(tilt), positions) - offset)


def sensor_axes(sensor: Sensor) -> Array:
    """Return the sensor's x, y and z axes in the motion's world, as rows (3, 3)."""
    yaw, _, tilt = _view(sensor)
    return rotate(inverse(multiply(tilt, yaw)), np.eye(3))
