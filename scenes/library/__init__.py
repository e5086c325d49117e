"""Scripted performers, and the props that follow their hands."""

from .performers import MOTIONS, perform, perform_medley
from .props import prop_poses

__all__ = ["MOTIONS", "perform", "perform_medley", "prop_poses"]
