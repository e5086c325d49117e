"""Gross failures of the tracker: found, reported, and mended where that is possible.

Sensors now and then take a person for one who faces the other way, and exchange left
and right from one frame to the next; they bend a leg the way no knee bends, put an arm
through the head, or let a limb leap to somewhere else and back. They put the whole body
where nobody gets so fast, or give it the size of a house. Most of it goes on for
many frames, so that nothing which looks at single frames or lengths minds it. What is
plausible but wrong shows in the end, as cleaning moves it far.
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
