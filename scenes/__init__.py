"""Where takes happen: rooms and props, scripted performers, the virtual Kinect."""

from .kinect import Sensor, observe, sample_take
from .performers import MOTIONS, Performance, perform, perform_medley
from .props import prop_poses
from .rooms import SCENES, load_scene, props, scene_xml

__all__ = [
    "MOTIONS",
    "SCENES",
    "Performance",
    "Sensor",
    "load_scene",
    "observe",
    "perform",
    "perform_medley",
    "prop_poses",
    "props",
    "sample_take",
    "scene_xml",
]
