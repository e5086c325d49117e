"""Scripted performers, and the props that follow their hands."""

from .gaits import Area
from .performers import MOTIONS, perform, perform_medley
from .props import prop_poses

__all__ = ["MOTIONS", "Area", "perform", "perform_medley", "prop_poses"]
