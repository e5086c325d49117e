"""Gross tracker failures: detection, description and, where possible, repair.

Sensors sometimes take a person who faces them for one who faces away and swap left and
right from one frame to the next; they bend a knee backwards, put an arm through the
head, or have a limb jump somewhere else and back. They place the whole body where
nobody could get so fast, or make it the size of a house. Most of this lasts for many
frames, so checks of single frames or of segment lengths miss it. Errors that look
plausible show only later, when cleaning has to move a limb far.
"""

from .bodies import ImpossibleBodies
from .displaced import find_displaced
from .gross import (
    Failure,
    FailureKind,
    distrust,
    find_failures,
    told_failures,
    unmirrored,
    without_nobody,
)

__all__ = [
    "Failure",
    "FailureKind",
    "ImpossibleBodies",
    "distrust",
    "find_displaced",
    "find_failures",
    "told_failures",
    "unmirrored",
    "without_nobody",
]
