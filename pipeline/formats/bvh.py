"""Motion in BVH files, of any skeleton and channel order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.rotations import multiply, rotate

from .euler import wxyz_from_euler

_UNITS = (1.0, 0.01, 0.001, 0.0254)  # m, cm, mm, inches
_LEG = 0.86  # m: thigh and shin of a body of 1.75 m (Winter 2009, figure 4.1)


def meters_by_leg(leg: float) -> float:
    """Return the unit [m] in which a leg (thigh and shin) is nearest to a person's."""
    return min(_UNITS, key=lambda unit: abs(np.log(unit * max(leg, 1e-9) / _LEG)))


@dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton of its own and its motion, in the file's own unit of length.

    End sites are joints without channels, called ``<Parent>End``. The rest posture has
    no rotation at all; each rotation turns a joint with all that hangs on it.
    """

    names: tuple[str, ...]
    """Joint names, every parent before its children."""
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for a root."""
    offsets: NDArray[np.float64]
    """Vector from the parent in the rest posture, shape (N, 3)."""
    channels: tuple[tuple[str, ...], ...]
    """Channels of each joint in their order, such as ``Xposition``, ``Zrotation``."""
    frame_time: float
    """Time between frames [s]."""
    motion: NDArray[np.float64]
    """Channel values, angles in degrees, shape (T, C)."""

    def __post_init__(self) -> None:
        for name in ("offsets", "motion"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each frame [s], the first at 0, shape (T,)."""
        return np.arange(len(self), dtype=np.float64) * self.frame_time

    @property
    def joints(self) -> list[int]:
        """Indices of the joints without the end sites."""
        return [
            n
            for n, (name, parent) in enumerate(
                zip(self.names, self.parents, strict=True)
            )
            if self.channels[n] or parent < 0 or name != f"{self.names[parent]}End"
        ]

    @cached_property
    def rest_positions(self) -> NDArray[np.float64]:
        """Position of each joint in the rest posture, shape (N, 3)."""
        places = np.array(self.offsets)
        for n, parent in enumerate(self.parents):
            places[n] += places[parent] if parent >= 0 else 0.0
        return places

    @cached_property
    def rotations(self) -> NDArray[np.float64]:
        """World rotation of each joint, unit quaternions wxyz, shape (T, N, 4)."""
        world = np.empty((len(self), len(self.names), 4))
        for n, parent in enumerate(self.parents):
            turns = [k for k, c in enumerate(self.channels[n]) if c[1:] == "rotation"]
            axes = "".join(self.channels[n][k][0] for k in turns)
            angles = np.radians(self.motion[:, self._columns(n)][:, turns])
            local = wxyz_from_euler(angles, axes)
            world[:, n] = local if parent < 0 else multiply(world[:, parent], local)
        return world

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """World position of each joint in the file's unit, shape (T, N, 3).

        A position channel takes the place of that coordinate of the offset.
        """
        world = np.empty((len(self), len(self.names), 3))
        for n, parent in enumerate(self.parents):
            local = np.broadcast_to(self.offsets[n], (len(self), 3)).copy()
            first = self._columns(n).start
            for k, channel in enumerate(self.channels[n]):
                if channel[1:] == "position":
                    local[:, "XYZ".index(channel[0])] = self.motion[:, first + k]
            if parent >= 0:
                local = world[:, parent] + rotate(self.rotations[:, parent], local)
            world[:, n] = local
        return world

    def _columns(self, joint: int) -> slice:
        first = sum(map(len, self.channels[:joint]))
        return slice(first, first + len(self.channels[joint]))
