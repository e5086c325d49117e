"""Where takes happen: rooms and props, scripted performers, the virtual Kinect."""

from .kinect import observe, sample_take
from .performers import MOTIONS, Performance, perform, perform_medley
from .props import prop_poses
from .rooms import SCENES, load_scene, movable_props, scene_xml
from .sensor import SENSORS, Sensor, in_sensor_frame, in_world_frame
from .tracker_errors import TrackerErrors

__all__ = [
    "MOTIONS",
    "SCENES",
    "SENSORS",
    "Performance",
    "Sensor",
    "TrackerErrors",
    "in_sensor_frame",
    "in_world_frame",
    "load_scene",
    "movable_props",
    "observe",
    "perform",
    "perform_medley",
    "prop_poses",
    "sample_take",
    "scene_xml",
]
