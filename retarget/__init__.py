"""One body to another: view, size, orientation, and maps to other rigs."""

from .body_size import Standardizer, measured_body
from .bone_lengths import BoneLengths
from .hands import Hands
from .heading_frame import HeadingFrame, find_yaw
from .orientation import hang_missing, rotations_from_positions
from .retargeting import Retargeted, retarget
from .rig_map import RIGS, load_rig_map
from .target_rig import built_rig, matched_rig

__all__ = [
    "RIGS",
    "BoneLengths",
    "Hands",
    "HeadingFrame",
    "Retargeted",
    "Standardizer",
    "built_rig",
    "find_yaw",
    "hang_missing",
    "load_rig_map",
    "matched_rig",
    "measured_body",
    "retarget",
    "rotations_from_positions",
]
