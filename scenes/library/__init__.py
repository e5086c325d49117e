"""Scripted performers, and the props that follow their hands."""

from .gaits import Area
from .moving_props import prop_poses
from .performers import MOTIONS, perform, perform_medley

__all__ = ["MOTIONS", "Area", "perform", "perform_medley", "prop_poses"]
