"""The raw take as a stick figure, its joints colored by how reliable they are."""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Clip, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import between, matrix_from_wxyz

from .reliability_colors import reliability_colors

_JOINT, _BONE = 0.032, 0.012  # m, radii of what is drawn
_AXIS = np.array([0.0, 0.0, 1.0])  # of a capsule
_BONE_COLOR = (0.25, 0.25, 0.28)


def figure_names(skeleton: Skeleton) -> list[str]:
    """Return the names of a figure's geoms: the joints, then the bones."""
    joints = [f"joint:{joint}" for joint in skeleton.joints]
    return joints + [f"bone:{skeleton.joints[j]}" for j in skeleton.segments]


class RawFigure:
    """Spheres and capsules of a model, put where a take has joints and bones.

    Args:
        model: Has a geom for each of ``figure_names``.
        positions: Joint positions [m], world frame, NaN: missing, shape (T, J, 3).
        clip: The frames that are drawn, with reliability.
    """

    def __init__(self, model: mujoco.MjModel, positions: Array, clip: Clip) -> None:
        self._model, self._positions = model, to_mujoco(positions)
        self._reliability = clip.reliability
        skeleton = clip.skeleton
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        geoms = np.array([model.geom(name).id for name in figure_names(skeleton)])
        self._joints, self._bones = np.split(geoms, [len(skeleton)])
        model.geom_type[self._bones] = mujoco.mjtGeom.mjGEOM_CAPSULE
        model.geom_size[self._joints] = _JOINT
        model.geom_size[self._bones, 0] = _BONE
        model.geom_rgba[self._bones, :3] = _BONE_COLOR

    def pose(self, data: mujoco.MjData, frame: int) -> None:
        """Put the figure where the take has it; what is missing is not drawn."""
        model, points = self._model, self._positions[frame]
        known = np.isfinite(points).all(axis=-1)
        colors = reliability_colors(self._reliability[frame])
        model.geom_rgba[self._joints, :3] = colors
        model.geom_rgba[self._joints, 3] = known
        model.geom_rgba[self._bones, 3] = known[self._ends] & known[self._starts]
        points = np.where(known[:, None], points, 0.0)
        bones = points[self._ends] - points[self._starts]
        lengths = np.maximum(np.linalg.norm(bones, axis=-1), 1e-6)
        model.geom_size[self._bones, 1] = 0.5 * lengths
        data.geom_xpos[self._joints] = points
        data.geom_xpos[self._bones] = 0.5 * (points[self._ends] + points[self._starts])
        along = matrix_from_wxyz(between(_AXIS, bones))
        data.geom_xmat[self._bones] = along.reshape(-1, 9)
