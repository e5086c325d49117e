"""What the character is pulled through: the corrected motion, smooth, on its floor.

``person`` measures the bones, ``smooth`` takes the tremble out, ``floor`` finds the
floor and the sensor's tilt, ``contacts`` says which feet stand, ``planting`` keeps them
there; ``target`` makes the motion of it all, ``placement`` says where it is in a scene.
"""

from .target import Feet, Target, make_target

__all__ = ["Feet", "Target", "make_target"]
