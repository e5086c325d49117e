"""The virtual Kinect as a camera: where it stands and what its lens and clock allow.

Sensor frame: origin at the sensor, y up, z from the sensor towards the person, x to
the sensor's left; a person who faces the sensor faces -z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import about_x, about_y, inverse, multiply, rotate


class DepthNoise(NamedTuple):
    """Standard deviation of one pixel's depth at z meters: a + b z + c z^2 [m]."""

    constant: float
    linear: float
    quadratic: float

    def at(self, depth: Array) -> Array:
        """Return the standard deviation [m] at depths [m]."""
        return np.asarray(
            self.constant + self.linear * depth + self.quadratic * depth**2
        )


_V2_NOISE = DepthNoise(0.0015, -0.0005, 0.0003)


@dataclass(frozen=True)
class Sensor:
    """One Kinect: its place, its lens and its clock. The defaults are a Kinect v2."""

    height: float = 1.0
    """Height of the sensor above the floor [m]."""
    distance: float = 2.7
    """Horizontal distance from the sensor to the origin of the motion's world [m]."""
    azimuth: float = 0.0
    """Angle by which the performer is turned to its left from facing the sensor
    [rad]."""
    tilt: float = 0.0
    """Angle by which the sensor looks up, negative: down [rad]."""
    field_of_view: tuple[float, float] = (np.radians(70.6), np.radians(60.0))
    """Horizontal and vertical angle of view [rad]."""
    resolution: tuple[int, int] = (512, 424)
    """Columns and rows of the depth image."""
    depth_range: tuple[float, float] = (0.5, 4.5)
    """Nearest and farthest depth that is measured [m]."""
    depth_noise: DepthNoise = _V2_NOISE
    """Noise of one pixel's depth (Fankhauser et al. 2015, Kinect v2 for mobile robot
    navigation, at normal incidence)."""
    structured_light: bool = False
    """Whether it measures disparity, in eighths of a pixel; else times of flight, in
    millimeters."""
    dropped_share: float = 0.014
    """Share of frames that never arrive, in [0, 1]; labanotation takes: 0.5 to 2.9 %
    of steps are two frames long (tests/calibrate_kinect.py)."""
    stamp_jitter: float = 0.0003
    """Standard deviation of the time stamps [s]; labanotation takes."""

    def pixels(self, depth: Array) -> Array:
        """Return how many pixels see one square metre across the view [1/m^2]."""
        columns, rows = self.resolution
        wide, high = (2.0 * np.tan(angle / 2.0) for angle in self.field_of_view)
        return np.asarray(columns * rows / (wide * high * depth**2))

    def in_view(self, positions: Array) -> Flags:
        """Return whether points (..., 3) of the sensor frame lie in view and range."""
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
"""Geometry of the Kinects, from their data sheets.

Depth noise of v1: triangulation's, 1.43 mm times the squared depth in meters
(Khoshelham & Elberink 2012, Sensors 12(2)). Of azure (narrow view): a
guess of 1 to 2 mm within its range.
The skeleton is that of the motion, whichever sensor looks at it.
"""


def _view(sensor: Sensor) -> tuple[Array, Array, Array]:
    """Return turn about the vertical, place [m] and tilt that lead to the frame."""
    place = np.array([0.0, -sensor.height, sensor.distance])
    return about_y(np.pi + sensor.azimuth), place, about_x(sensor.tilt)


def in_sensor_frame(positions: Array, sensor: Sensor) -> Array:
    """Turn positions [m] of a motion, world, (..., 3), into the sensor's frame."""
    turn, place, tilt = _view(sensor)
    return rotate(tilt, rotate(turn, positions) + place)


def in_world_frame(positions: Array, sensor: Sensor) -> Array:
    """Turn positions [m] of a take, (..., 3), into the world of the motion."""
    turn, place, tilt = _view(sensor)
    return rotate(inverse(turn), rotate(inverse(tilt), positions) - place)


def sensor_axes(sensor: Sensor) -> Array:
    """Return the sensor's x, y and z axis in the motion's world, (3, 3) rows."""
    turn, _, tilt = _view(sensor)
    return rotate(inverse(multiply(tilt, turn)), np.eye(3))
