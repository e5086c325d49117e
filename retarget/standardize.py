"""Removes position, heading and body size from postures, and restores them.

Every bone is scaled by a constant, standard length over the person's length, and
rotated by a constant where the sensor places trunk, hips or shoulders differently, so
the map is linear and exactly invertible. Bones keep each frame's deviation from their
length: in a person of ordinary proportions, a wrong elbow then leaves the wrist where
it was measured. A chain of bones of fixed length would not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body, InputError, Skeleton, standard_body
from kinefilter.characters.anthropometry import STANDARD_HEIGHT, STATURES, unit_hint
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_y,
    between,
    inverse,
    matrix_from_wxyz,
    multiply,
    rotate,
)
from kinefilter.characters.skeleton import SIDES


@dataclass(frozen=True, eq=False)
class HeadingFrame:
    """Position and heading of a character."""

    root: Array  # position of the root joint [m], world frame, shape (..., 3)
    yaw: Array  # heading: angle about the vertical axis [rad], 0 facing +z, shape (...)

    def at(self, frames: Any) -> HeadingFrame:
        """Return the heading frame of some frames, or of one."""
        return HeadingFrame(self.root[frames], self.yaw[frames])

    @property
    def unturned(self) -> HeadingFrame:
        """The same position, facing +z."""
        return HeadingFrame(self.root, np.zeros_like(self.yaw))

    def remove(self, positions: Array) -> Array:
        """Return positions [m] relative to the root, facing +z, shape (..., J, 3)."""
        return _turned(positions - self.root[..., None, :], -self.yaw)

    def restore(self, positions: Array) -> Array:
        """Undo ``remove``."""
        return _turned(positions, self.yaw) + self.root[..., None, :]

    @property
    def origin(self) -> Array:
        """World origin (the sensor) relative to the root [m], shape (..., 3)."""
        return self.remove(np.zeros((*self.yaw.shape, 1, 3)))[..., 0, :]

    def remove_rotations(self, rotations: Array) -> Array:
        """Return world rotations relative to the heading, wxyz, shape (..., J, 4)."""
        return multiply(inverse(about_y(self.yaw))[..., None, :], rotations)

    def restore_rotations(self, rotations: Array) -> Array:
        """Undo ``remove_rotations``."""
        return multiply(about_y(self.yaw)[..., None, :], rotations)


def floor_frame(pelvis: Array, turns: Array, left: ArrayLike) -> HeadingFrame:
    """Return a pelvis' place on the floor and its heading relative to the rest pose.

    Positions [m] (T, 3) have y up, rotations from the rest pose are wxyz (T, 4), and
    ``left`` (3,) is the direction to the left in the rest pose.
    """
    now, rest = rotate(turns, left), np.asarray(left)
    yaw = np.arctan2(-now[..., 2], now[..., 0]) - np.arctan2(-rest[2], rest[0])
    return HeadingFrame(pelvis * [1.0, 0.0, 1.0], yaw)


def _turned(positions: Array, yaw: Array) -> Array:
    """Return positions (..., J, 3) turned about y by yaw (...), faster than rotate."""
    sine, cosine = np.sin(yaw)[..., None], np.cos(yaw)[..., None]
    x, z = positions[..., 0], positions[..., 2]
    turned = np.empty(positions.shape)
    turned[..., 0] = cosine * x + sine * z
    turned[..., 1] = positions[..., 1]
    turned[..., 2] = cosine * z - sine * x
    return turned


def find_yaw(
    positions: Array, skeleton: Skeleton, weights: Array | None = None
) -> Array:
    """Return the heading [rad] of postures, NaN where it cannot be found.

    It is perpendicular to the lines through hips and shoulders, projected on the floor
    and weighted by the weights of both ends (..., J), if given. Positions [m] (...,
    J, 3) have y up and are NaN where missing.
    """
    left, right = skeleton.across
    lines = positions.take(left, -2) - positions.take(right, -2)
    known = ~np.isnan(lines)
    if weights is not None:
        lines *= (weights[..., left] * weights[..., right])[..., None]
    line = lines.sum(axis=-2, where=known)
    x, z = line[..., 0], line[..., 2]
    return np.where(np.hypot(x, z) > 1e-6, np.arctan2(-z, x), np.nan)


# A segment longer or shorter than average by such a factor is a tracking error. Joints
# of the trunk have no landmarks, so sensors differ more there. Shoulders and hips
# depend on them, and shoulders near the trunk when arms reach forward. All are guesses;
# a real Kinect v1 shows the lowest bone of the trunk up to 4.1 times shorter.
# In p00 to p08 of two-kinects and s02, s03 and s04 of UI-PRMD, both hips together are
# 0.71 to 1.30 of average, and hips and shoulders up to 39 degrees ahead or behind.
_WORST_LIMB, _WORST_SHOULDER, _WORST_TRUNK = 1.6, 2.0, 6.0


def measured_body(
    skeleton: Skeleton,
    lengths: Array,
    directions: Array | None = None,
    *,
    height: float | None = None,
    mass: float | None = None,
    source: str = "take",
) -> Body:
    """Return the body of a person whose segments were measured.

    Left and right get the mean of both. Unmeasured legs follow from arms and trunk, and
    arms from legs and trunk. Other segments that were not measured get average
    proportions, and so do those that differ from them by a factor of 1.6 or more (2 for
    shoulders and hips, 4 along the trunk), both hips if they are narrower by 1.6, and
    directions of hips and shoulders more ahead or behind than to the side. Segment
    lengths [m] (J,) and unit rest directions (J, 3) are NaN where unknown. Unless
    given, stature [m] follows from the lengths and mass [kg] from the stature; an
    InputError says if they are not human.
    """
    average = standard_body(skeleton).lengths
    lengths = _with_limbs(skeleton, np.where(lengths > 0, lengths, np.nan), average)
    known = _mean_of_sides(skeleton, lengths)
    legs = [skeleton.index("KneeLeft"), skeleton.index("AnkleLeft")]
    stack = [*legs, *skeleton.ancestors(skeleton.index("Head"))]
    upright = [j for j in stack if np.isfinite(known[j])]
    share = known[upright].sum() / average[upright].sum() if upright else 1.0
    stature = STANDARD_HEIGHT * float(share)
    if not STATURES[0] <= stature <= STATURES[1]:
        raise InputError(
            f"{source}: the segments suggest a stature of {stature:.3g} m, expected "
            f"{STATURES[0]:g} to {STATURES[1]:g} m; {unit_hint(stature)}"
        )
    height = stature if height is None else height
    body = standard_body(skeleton, height=height, mass=mass)
    trunk = skeleton.mirror == np.arange(len(skeleton))
    first = ~trunk & trunk[list(skeleton.parents)]  # hips and shoulders
    factor = np.where(first, _WORST_SHOULDER, _WORST_LIMB)
    factor = np.where(trunk, _WORST_TRUNK, factor)
    valid = (lengths < factor * body.lengths) & (lengths * factor > body.lengths)
    known = _mean_of_sides(skeleton, np.where(valid, lengths, np.nan))
    hips = skeleton.hips
    known[hips] = np.where(known * _WORST_LIMB < body.lengths, np.nan, known)[hips]
    lengths = np.where(np.isnan(known), body.lengths, known)
    if directions is None:
        return replace(body, lengths=lengths)
    both = _mean_of_sides(skeleton, directions, np.array([-1.0, 1.0, 1.0]))
    norms = np.linalg.norm(both, axis=1, keepdims=True)
    ahead = first & (np.abs(both[:, 2]) > np.abs(both[:, 0]))
    plausible = (norms > 0.5) & ~ahead[:, None]
    turned = np.where(plausible, both / np.maximum(norms, 0.5), body.directions)
    return replace(body, lengths=lengths, directions=turned)


# Length of trunk, thigh and shank together, in lengths of an arm. Sensors differ in how
# high they see the hips, but not in this: as seen, it is 2.59 in CMU's mocap, 2.53 in
# p00 to p08 of two-kinects and 2.57 in s02, s03 and s04; after correction 2.62 to 2.66.
_TRUNK_AND_LEG = 2.6


def _with_limbs(skeleton: Skeleton, lengths: Array, average: Array) -> Array:
    """Return lengths [m] (J,) in which seen arms tell unseen legs, or the reverse."""
    arm, leg = (
        [skeleton.index(part + SIDES[0]) for part in parts]
        for parts in (("Elbow", "Wrist"), ("Knee", "Ankle"))
    )
    stack, found = [*skeleton.ancestors(skeleton.girdle), *leg], lengths.copy()
    known = _mean_of_sides(skeleton, lengths)
    for limb, gone, length in (
        (leg, stack, _TRUNK_AND_LEG * known[arm].sum() - np.nansum(known[stack])),
        (arm, arm, known[stack].sum() / _TRUNK_AND_LEG),
    ):
        if np.isnan(known[limb]).all() and length > 0.0:
            some = [j for j in gone if np.isnan(known[j])]
            found[some] = average[some] * (length / average[some].sum())
    return found


def _mean_of_sides(skeleton: Skeleton, values: Array, signs: Any = 1.0) -> Array:
    """Return the mean of left and right, mirrored by signs, ignoring NaN."""
    mirrored = values[skeleton.mirror] * signs
    both = np.where(np.isnan(mirrored), values, (values + mirrored) / 2.0)
    return np.where(np.isnan(values), mirrored, both)


class Standardizer:
    """Conversion of a person's postures to the standard body, facing +z, and back."""

    def __init__(self, body: Body) -> None:
        self.body = body
        skeleton = body.skeleton
        standard = standard_body(skeleton)
        ends = skeleton.segments
        scale = np.ones((len(skeleton), 1, 1))
        scale[ends, 0, 0] = standard.lengths[ends] / body.lengths[ends]
        turns = matrix_from_wxyz(between(body.directions, standard.directions))
        self._to_standard = scale * turns
        self._to_person = np.ascontiguousarray(turns.transpose(0, 2, 1) / scale)
        self._chain = chain_matrix(skeleton)
        self.start()

    def start(self) -> None:
        """Reset the last known root, heading and bones for a new motion."""
        self._root = np.zeros(3)
        self._yaw = np.array(np.nan)
        self._bones = self.body.rest_offsets.copy()

    def step(self, positions: Array, weights: Array) -> tuple[Array, HeadingFrame]:
        """Return a posture on the standard body, and the heading frame taken out.

        The root is at the origin, facing +z. A missing root or heading is that of the
        previous frame; a joint whose parent is missing is placed by the parent's last
        known bone. Positions [m] (J, 3) are NaN where missing, weights are (J,).
        """
        standard, view = self.steps(positions[None], weights[None])
        return standard[0], view.at(0)

    def steps(self, positions: Array, weights: Array) -> tuple[Array, HeadingFrame]:
        """Return the next frames, (T, J, 3) and (T, J), as ``step`` one by one.

        But frames before the first heading get that one, which ``step`` cannot know.
        """
        skeleton = self.body.skeleton
        missing = np.isnan(positions[..., 0])
        root = _filled_forward(positions[:, skeleton.root], self._root)
        yaw = find_yaw(positions, skeleton, weights)
        if np.isnan(self._yaw):
            self._yaw = next(iter(yaw[~np.isnan(yaw)]), np.array(0.0))
        yaw = _filled_forward(yaw, self._yaw)
        view = HeadingFrame(root, yaw)
        local = view.remove(positions)
        if missing.any():
            local[:, skeleton.root] = 0.0
            for j in skeleton.order[1:]:
                parent = local[:, skeleton.parents[j]]
                bone = np.where(missing[:, j, None], np.nan, local[:, j] - parent)
                local[:, j] = parent + _filled_forward(bone, self._bones[j])
        bones = self._bones_of(local)
        self._root, self._yaw, self._bones = root[-1], yaw[-1], bones[-1]
        standard = self._chain @ _apply(self._to_standard, bones)
        standard[missing] = np.nan
        return standard, view

    def standardize(self, positions: Array, view: HeadingFrame) -> Array:
        """Return postures (..., J, 3) in the world frame on the standard body.

        The root may differ from the frame's, and keeps its distance from the origin. If
        a joint is missing, so are its descendants.
        """
        bones = self._bones_of(view.remove(positions))
        missing = np.isnan(bones)
        bones = _apply(self._to_standard, np.where(missing, 0.0, bones))
        missing = (self._chain @ missing.astype(float)) > 0.0
        return np.where(missing, np.nan, self._chain @ bones)

    def undo(self, positions: Array, view: HeadingFrame) -> Array:
        """Return standard postures (..., J, 3) on the person's body in the world."""
        bones = _apply(self._to_person, self._bones_of(positions))
        return view.restore(self._chain @ bones)

    def _bones_of(self, positions: Array) -> Array:
        """Return the vector to each joint from its parent, to the root from 0."""
        skeleton = self.body.skeleton
        bones = positions.copy()
        bones[..., skeleton.segments, :] = skeleton.bones(positions)
        return bones


def _apply(matrices: Array, bones: Array) -> Array:
    return np.asarray((matrices @ bones[..., None])[..., 0])


def _filled_forward(values: Array, before: Array) -> Array:
    """Return values (T, ...) with NaN replaced by the last value before it."""
    valid = ~np.isnan(values).reshape(len(values), -1)[:, 0]
    if valid.all():
        return values
    last = np.maximum.accumulate(np.where(valid, np.arange(1, len(values) + 1), 0))
    return np.concatenate([before[None], values])[last]


def chain_matrix(skeleton: Skeleton) -> Array:
    """Return the matrix (J, J) that adds up bones from the root to every joint."""
    chain = np.eye(len(skeleton))
    for j in skeleton.order[1:]:
        chain[j] += chain[skeleton.parents[j]]
    return chain
