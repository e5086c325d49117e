"""Conversion between bodies: heading, size, orientation and other rigs."""

from .bone_lengths import BoneLengths
from .orientation import (
    Hinges,
    fill_missing_joints,
    rotations_from_positions,
)
from .standardize import HeadingFrame, Standardizer, find_yaw, measured_body
from .straight_chains import Neck, Palms

__all__ = [
    "BoneLengths",
    "HeadingFrame",
    "Hinges",
    "Neck",
    "Palms",
    "Standardizer",
    "fill_missing_joints",
    "find_yaw",
    "measured_body",
    "rotations_from_positions",
]
