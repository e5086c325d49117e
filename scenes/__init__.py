"""Where takes happen: scripted performers, the virtual Kinect, sample takes."""

from .kinect import Sensor, observe, sample_take
from .performers import MOTIONS, Performance, perform, perform_medley

__all__ = [
    "MOTIONS",
    "Performance",
    "Sensor",
    "observe",
    "perform",
    "perform_medley",
    "sample_take",
]
