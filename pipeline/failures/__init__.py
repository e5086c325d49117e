"""Gross tracker failures: detection, description and, where possible, repair.

Sensors take a person whom they see from behind for one who faces them, with left and
right swapped; they bend a knee backwards, put an arm through the head, or have a limb
jump somewhere else and back. They place the whole body where nobody could get so fast,
let it sink through the floor, or make it the size of a house. Most of this lasts for
many frames, so checks of single frames or of segment lengths miss it. Errors that look
plausible show only later, when cleaning has to move a limb far.
"""

from .bodies import ImpossibleBodies, stray_joints
from .gross import (
    Failure,
    FailureKind,
    describe_damage,
    describe_failures,
    find_displaced,
    find_failures,
    lost_joints,
    repaired,
    unmirrored,
)

__all__ = [
    "Failure",
    "FailureKind",
    "ImpossibleBodies",
    "describe_damage",
    "describe_failures",
    "find_displaced",
    "find_failures",
    "lost_joints",
    "repaired",
    "stray_joints",
    "unmirrored",
]
