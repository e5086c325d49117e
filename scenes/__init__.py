"""Scenes: rooms and their props.

``library`` has scripted performers and ``sensor`` the virtual Kinect. Cleaning a take
imports neither.
"""

from .rooms import SAMPLE, SCENES, load_scene, scene_xml

__all__ = ["SAMPLE", "SCENES", "load_scene", "scene_xml"]
