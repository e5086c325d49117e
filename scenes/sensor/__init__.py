"""The virtual Kinect: simulated takes of a motion."""

from .geometry import SENSORS, Sensor, in_sensor_frame, in_world_frame
from .kinect import Tracker, observe, sample_take
from .tracker_errors import TrackerErrors

__all__ = [
    "SENSORS",
    "Sensor",
    "Tracker",
    "TrackerErrors",
    "in_sensor_frame",
    "in_world_frame",
    "observe",
    "sample_take",
]
