"""Finds knees that a sensor only guesses, although it sees hips and ankles.

So does a Kinect with knees behind a desk. It guesses legs that hang, also of people who
sit; where knees are follows better from the rest of the body.
"""

import numpy as np

from kinefilter.characters import State, Take
from kinefilter.characters.arrays import Flags
from kinefilter.characters.skeleton import SIDES

from .limb_failures import LIMBS

_RARELY, _MOSTLY = 0.3, 0.5  # shares of the frames. Guesses.


def guessed_knees(take: Take) -> Flags:
    """Return True for guesses of knees that are rarely tracked, unlike the leg, (T, J).

    Where a whole leg is guessed, the sensor's guess is better than none.
    """
    tracked = take.state == State.TRACKED
    share, guessed = tracked.mean(axis=0), np.zeros_like(tracked)
    for side in SIDES:
        hip, knee, ankle = (take.skeleton.index(part + side) for part in LIMBS["leg"])
        if share[knee] <= _RARELY and min(share[[hip, ankle]]) > _MOSTLY:
            guessed[:, knee] = ~tracked[:, knee]
    return np.asarray(guessed)
