"""The sensors of a session in a clip's frame: where they are and what each saw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinefilter.characters import KINECT_V1, Skeleton
from kinefilter.characters.arrays import Array

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged

COLORS = ((0, 140, 140), (205, 40, 130), (135, 95, 15), (60, 130, 225))
"""Colors of the sensors, in order and repeating."""
_FIELD_V1, _FIELD_V2 = (57.0, 43.0), (70.0, 60.0)
"""Horizontal and vertical fields of view of the depth cameras [degrees], from
Microsoft's specifications of Kinect for Windows v1 and v2."""
_DEPTH = 0.6  # m, depth of a frustum
_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
_FRAMES = 1000  # are enough to find the transform from the take to the clip


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor of a session and what it saw, in the world frame of a clip."""

    name: str
    """Number of the sensor, from 1, and name of its take."""
    color: tuple[int, int, int]
    """Red, green and blue, 0 to 255."""
    skeleton: Skeleton
    """Skeleton of the merged take."""
    joints: Array
    """Joint positions it saw at the clip's frames [m], NaN where none, (T, J, 3)."""
    residuals: Array
    """Distances of these from the joints of the merged take [m], shape (T, J)."""
    shares: Array
    """Share of this sensor in each merged joint, 0 to 1, shape (T, J)."""
    frustum: Array
    """Position [m], and corners of its view 0.6 m away: upper left, upper right, lower
    right and lower left of its picture, shape (5, 3)."""
    figures: dict[str, Any]
    """Row of the sensor in ``Merged.figures``."""

    @property
    def edges(self) -> Array:
        """Edges of the frustum, then a line down to the floor [m], shape (9, 2, 3)."""
        eye, *corners = self.frustum
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        below = eye * [1.0, 0.0, 1.0]
        return np.array([*((eye, corner) for corner in corners), *sides, (eye, below)])


def sensors_of(merged: Merged, raw: Array) -> tuple[Sensor, ...]:
    """Return the sensors of a merged take in the frame of its clip.

    ``raw`` is the merged take [m] in that frame, shape (T, J, 3).
    """
    from kinefilter.pipeline.merge.rigid import placement

    some = slice(None, None, max(1, len(raw) // _FRAMES))
    placed = placement(merged.take.positions[some], raw[some])
    sensors = []
    rows, residuals = merged.figures()["sensors"], merged.residuals
    for k, (take, row) in enumerate(zip(merged.takes, rows, strict=True)):
        # In its own frame, a sensor is at the origin and looks along +z.
        field = _FIELD_V1 if take.skeleton == KINECT_V1 else _FIELD_V2
        corners = np.zeros((5, 3))
        corners[1:, :2] = _DEPTH * (_CORNERS * np.tan(0.5 * np.radians(field)))
        corners[1:, 2] = _DEPTH
        if k:
            corners = merged.alignments[k - 1].placed.apply(corners)
        sensors.append(
            Sensor(
                name=f"{k + 1}: {Path(take.source.removesuffix('.gz')).stem}",
                color=COLORS[k % len(COLORS)],
                skeleton=merged.take.skeleton,
                joints=placed.apply(merged.seen[k]),
                residuals=residuals[k],
                shares=merged.shares[:, k],
                frustum=placed.apply(corners),
                figures=row,
            )
        )
    return tuple(sensors)
