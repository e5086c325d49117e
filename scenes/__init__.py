"""Where takes happen: rooms and their props.

``library`` has scripted performers and ``sensor`` the virtual Kinect; nothing that
cleans a take imports these two.
"""

from .rooms import SAMPLE, SCENES, load_scene, scene_xml

__all__ = ["SAMPLE", "SCENES", "load_scene", "scene_xml"]
