"""The sensors of a session in the room of a clip: where they stand, what each saw."""

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
"""Of the first sensor, the second and so on, from the first again after the last."""
_FIELD_V1, _FIELD_V2 = (57.0, 43.0), (70.0, 60.0)
"""Fields of view, across and upright [degrees], of the depth cameras: Microsoft's
specifications of Kinect for Windows and of its second version."""
_DEPTH = 0.6  # m that a frustum is deep
_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
_FRAMES = 1000  # are enough to tell where a clip lies


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor of a session, and what it saw, in the world frame of a clip."""

    name: str
    """Its number, from 1, and the name of its take."""
    color: tuple[int, int, int]
    """Red, green and blue, 0 to 255."""
    skeleton: Skeleton
    """Of the merged take."""
    joints: Array
    """Where it saw the joints at the frames of the clip [m], NaN where it saw none,
    shape (T, J, 3)."""
    residuals: Array
    """How far those are from the joints of the merged take [m], shape (T, J)."""
    shares: Array
    """How much of each merged joint is of this sensor, 0 to 1, shape (T, J)."""
    frustum: Array
    """Where it is, and the corners of what it sees 0.6 m away: upper left, upper right,
    lower right and lower left of its picture [m], shape (5, 3)."""
    figures: dict[str, Any]
    """Its row of ``Merged.figures``."""

    @property
    def edges(self) -> Array:
        """Edges of the frustum, then from the sensor to the floor [m], (9, 2, 3)."""
        eye, *corners = self.frustum
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        below = eye * [1.0, 0.0, 1.0]
        return np.array([*((eye, corner) for corner in corners), *sides, (eye, below)])


def sensors_of(merged: Merged, raw: Array) -> tuple[Sensor, ...]:
    """Return the sensors of a merged take in the frame of its clip.

    ``raw`` is the merged take [m] in that frame, shape (T, J, 3).
    """
    from kinefilter.pipeline.merge.rigid import placement

    few = slice(None, None, max(1, len(raw) // _FRAMES))
    placed = placement(merged.take.positions[few], raw[few])
    sensors = []
    rows, residuals = merged.figures()["sensors"], merged.residuals
    for k, (take, row) in enumerate(zip(merged.takes, rows, strict=True)):
        corners = _frustum(take.skeleton)
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


def _frustum(skeleton: Skeleton) -> Array:
    """Return a frustum [m] in the frame of its sensor, which looks along z, (5, 3)."""
    field = _FIELD_V1 if skeleton == KINECT_V1 else _FIELD_V2
    half = np.tan(0.5 * np.radians(field))
    corners = np.column_stack([_CORNERS * half, np.ones(4)])
    return np.vstack([np.zeros(3), _DEPTH * corners])
