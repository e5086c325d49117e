"""A take as the correction methods see it: scored, on the standard body, one view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters import Body, Take
from kinefilter.characters.arrays import Array
from kinefilter.retarget import HeadingFrame, Standardizer

from .reliability import Reliability


@dataclass(frozen=True, eq=False)
class StandardTake:
    """Postures on the standard body, root at the origin, facing +z."""

    time: Array
    """Time stamps [s], strictly increasing, shape (T,)."""
    positions: Array
    """Joint positions [m], NaN where missing, shape (T, J, 3)."""
    reliability: Reliability
    """Of every joint and frame."""
    views: HeadingFrame
    """What was taken out: root (T, 3) and yaw (T,)."""
    body: Body
    """The person, for the way back."""

    def undo(self, positions: Array) -> Array:
        """Return standard postures (T, J, 3) on the person, in the sensor's frame."""
        return Standardizer(self.body).undo(positions, self.views)

    def alongside(self, positions: Array, measured: Array) -> Array:
        """Return another measurement of the frames, such as mocap's, likewise.

        Args:
            positions: Joint positions [m], the sensor's frame, NaN where the other
                has none (and stays so), shape (T, J, 3).
            measured: What to take for them on the way, shape (T, J, 3).
        """
        filled = np.where(np.isnan(positions), measured, positions)
        standard = Standardizer(self.body).standardize(filled, self.views)
        return np.where(np.isnan(positions), np.nan, standard)


def standardize_take(take: Take, body: Body, reliability: Reliability) -> StandardTake:
    """Bring a take to the standard body and view.

    Args:
        take: The recording, time stamps strictly increasing.
        body: The person.
        reliability: Of every joint and frame of the take.
    """
    standardizer = Standardizer(body)
    positions, views = standardizer.steps(take.positions, reliability.rate)
    return StandardTake(take.time, positions, reliability, views, body)
