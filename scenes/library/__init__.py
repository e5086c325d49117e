"""Scripted performers, and props that follow their hands."""

from .gaits import Area
from .moving_props import movable_props, prop_poses
from .performers import MOTIONS, perform, perform_medley, random_body

__all__ = [
    "MOTIONS",
    "Area",
    "movable_props",
    "perform",
    "perform_medley",
    "prop_poses",
    "random_body",
]
