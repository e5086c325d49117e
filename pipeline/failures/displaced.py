"""Limbs that cleaning moved so far that the sensor must have misplaced them.

The distance by which a joint is moved detects wrong joints better than any reliability.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.skeleton import SIDES
from kinefilter.retarget import HeadingFrame

from .gross import Failure, FailureKind, stretches
from .limb_failures import LIMBS

_FAR = 0.09
"""Distance [m], relative to the joint's mean over the take, from which a limb is
reported. Chosen so that, whichever of six people is left out, 5 % of the others' clips
in which no joint is 12 cm off are reported."""
_WINDOW = 0.5  # s over which the distance is averaged


def find_displaced(
    time: Array, raw: Array, clean: Array, yaw: Array, skeleton: Skeleton
) -> Iterator[Failure]:
    """Yield the stretches in which cleaning moved a limb far relative to the hips.

    Positions [m] (T, J, 3) are those of the sensor, NaN where missing, and those after
    cleaning; time stamps [s] (T,) increase strictly, and ``yaw`` (T,) is the heading.
    """
    hips = (clean[:, skeleton.hips] - raw[:, skeleton.hips]).mean(axis=1, keepdims=True)
    heading = HeadingFrame(np.zeros((len(time), 3)), yaw)
    frames, parts = max(round(_WINDOW / nominal_step(time)), 1), parts_of(time)
    for side in SIDES:
        for limb, (_, *ends) in LIMBS.items():
            far = np.zeros(len(time), dtype=bool)
            for joint in ends:
                j = [skeleton.index(joint + side)]
                move = heading.remove(clean[:, j] - raw[:, j] - hips)[:, 0]
                known = ~np.isnan(move[:, 0])
                if known.any():
                    move = np.nan_to_num(move - move[known].mean(axis=0))
                    away = np.linalg.norm(move, axis=1)
                    for part in parts:
                        far[part] |= uniform_filter1d(away[part], frames) > _FAR
            what = FailureKind.DISPLACED, f"{side.lower()} {limb}"
            for part in parts:
                found = stretches(time[part], *what, far[part])
                yield from (failure.moved(part.start) for failure in found)
