"""One body to another: view, size, orientation, and maps to other rigs."""

from .body_size import Standardizer, measured_body
from .bone_lengths import BoneLengths
from .kinematics import positions_from_rotations
from .normalise import View, find_yaw
from .orientation import rotations_from_positions

__all__ = [
    "BoneLengths",
    "Standardizer",
    "View",
    "find_yaw",
    "measured_body",
    "positions_from_rotations",
    "rotations_from_positions",
]
