"""Limbs that cleaning had to move so far that the sensor must have placed them wrongly.

How far a joint is moved tells joints that are off better than any reliability does.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import uniform_filter1d

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, runs
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.motion import nominal_step
from kinefilter.retarget import HeadingFrame

from .gross import Failure, FailureKind

_FAR = 0.09
"""Distance [m], the mean over the take aside, from which it is told. Whichever of six
people is left out: of the others' clips without a joint 12 cm off, 5 % are told."""
_WHILE = 0.5  # s over which the distance is a mean
_LIMBS = {"arm": ("Elbow", "Wrist"), "leg": ("Knee", "Ankle")}


def find_displaced(
    time: Array, raw: Array, clean: Array, yaw: Array, skeleton: Skeleton
) -> Iterator[Failure]:
    """Yield where limbs were moved far, relative to the middle of the hips.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        raw: Joint positions [m] as the sensor saw them, NaN where missing, (T, J, 3).
        clean: The same after cleaning, shape (T, J, 3).
        yaw: Heading of the person [rad], shape (T,).
        skeleton: The joints.
    """
    names = [
        (f"{side} {limb}", [part + side.capitalize() for part in parts])
        for side in ("left", "right")
        for limb, parts in _LIMBS.items()
    ]
    joints = [skeleton.index(joint) for _, parts in names for joint in parts]
    hips = (clean[:, skeleton.hips] - raw[:, skeleton.hips]).mean(axis=1, keepdims=True)
    heading = HeadingFrame(np.zeros((len(time), 3)), yaw)
    moved = heading.remove(clean[:, joints] - raw[:, joints] - hips)
    frames, parts = max(round(_WHILE / nominal_step(time)), 1), parts_of(time)
    for k, (limb, _) in enumerate(names):
        far = np.zeros(len(time), dtype=bool)
        for j in (2 * k, 2 * k + 1):
            known = ~np.isnan(moved[:, j, 0])
            if known.any():
                away = moved[:, j] - moved[known, j].mean(axis=0)
                distance = np.nan_to_num(np.linalg.norm(away, axis=1))
                for part in parts:
                    far[part] |= uniform_filter1d(distance[part], frames) > _FAR
        for part, run in ((p, run) for p in parts for run in runs(far[p])):
            first, last = part.start + run.start, part.start + run.stop - 1
            start, end = float(time[first]), float(time[last])
            yield Failure(FailureKind.DISPLACED, limb, first, last, start, end)
