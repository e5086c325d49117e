"""Conversion between bodies: heading, size, orientation and other rigs."""

from .body_size import Standardizer, measured_body
from .bone_lengths import BoneLengths
from .heading_frame import HeadingFrame, find_yaw
from .orientation import fill_missing_joints, rotations_from_positions
from .straight_chains import Neck, Palms

__all__ = [
    "BoneLengths",
    "HeadingFrame",
    "Neck",
    "Palms",
    "Standardizer",
    "fill_missing_joints",
    "find_yaw",
    "measured_body",
    "rotations_from_positions",
]
