"""One body's size to another's: what the person measures, and the standard body.

Every bone is scaled by a constant, standard length over the person's length, and turned
by a constant where the sensor has another notion of trunk, hips and shoulders, so the
map is linear and exact both ways. Bones keep the frame's own deviation from their
length: where the person's proportions are ordinary, a wrong elbow then leaves the
wrist where it was measured, which a walk with fixed lengths would not.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import (
    STANDARD_HEIGHT,
    STATURES,
    Body,
    InputError,
    Skeleton,
    standard_body,
    unit_hint,
)
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, matrix_from_wxyz

from .heading_frame import HeadingFrame, find_yaw

# A segment that many times off the average is a tracker's error. Along the trunk the
# joints have no landmarks, and sensors differ by more. Shoulders and hips hang on it,
# and shoulders come near to it where arms reach forward. All are guesses.
_ODDEST_LIMB, _ODDEST_SHOULDER, _ODDEST_TRUNK = 1.6, 2.0, 4.0


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

    Left and right share the mean of what was measured. What was not measured takes
    average proportions, and so does what is off them by a factor of 1.6 or more,
    shoulders and hips 2, along the trunk 4. Segment lengths [m] and unit rest
    directions are NaN where unknown, shapes (J,) and (J, 3); stature [m] follows from
    the lengths and mass [kg] from the stature unless given. Raises InputError if height
    or mass is not a human's.
    """
    average = standard_body(skeleton).lengths
    known = np.where(lengths > 0, lengths, np.nan)
    known = _mean_of_sides(known, known[skeleton.mirror])
    legs = [skeleton.index("KneeLeft"), skeleton.index("AnkleLeft")]
    stack = [*legs, *skeleton.up_from(skeleton.index("Head"))]
    upright = [j for j in stack if np.isfinite(known[j])]
    share = known[upright].sum() / average[upright].sum() if upright else 1.0
    stature = STANDARD_HEIGHT * float(share)
    if not STATURES[0] < stature < STATURES[1]:
        raise InputError(
            f"{source}: the segments measure a stature of {stature:.3g} m, expected "
            f"{STATURES[0]:g} to {STATURES[1]:g} m; {unit_hint(stature)}"
        )
    height = stature if height is None else height
    body = standard_body(skeleton, height=height, mass=mass)
    trunk = skeleton.mirror == np.arange(len(skeleton))
    beside = np.where(trunk[list(skeleton.parents)], _ODDEST_SHOULDER, _ODDEST_LIMB)
    factor = np.where(trunk, _ODDEST_TRUNK, beside)
    sane = (lengths < factor * body.lengths) & (lengths * factor > body.lengths)
    known = np.where(sane, lengths, np.nan)
    known = _mean_of_sides(known, known[skeleton.mirror])
    lengths = np.where(np.isnan(known), body.lengths, known)
    if directions is None:
        return Body(skeleton, body.height, body.mass, lengths, body.directions)
    mirrored = directions[skeleton.mirror] * np.array([-1.0, 1.0, 1.0])
    both = _mean_of_sides(directions, mirrored)
    norms = np.linalg.norm(both, axis=1, keepdims=True)
    turned = np.where(norms > 0.5, both / np.maximum(norms, 0.5), body.directions)
    return Body(skeleton, body.height, body.mass, lengths, turned)


def _mean_of_sides(values: Array, mirrored: Array) -> Array:
    """Return the mean of what is there of two arrays, NaN where nothing is."""
    both = np.where(np.isnan(mirrored), values, (values + mirrored) / 2.0)
    return np.where(np.isnan(values), mirrored, both)


class Standardizer:
    """Brings a person's postures to the standard body and view, and back."""

    def __init__(self, body: Body) -> None:
        self.body = body
        skeleton = body.skeleton
        standard = standard_body(skeleton)
        ends = skeleton.segments
        self._to_standard = np.tile(np.eye(3), (len(skeleton), 1, 1))
        self._to_person = self._to_standard.copy()
        turns = matrix_from_wxyz(between(body.directions, standard.directions))
        scale = (standard.lengths[ends] / body.lengths[ends])[:, None, None]
        self._to_standard[ends] = scale * turns[ends]
        self._to_person[ends] = turns[ends].transpose(0, 2, 1) / scale
        self._chain = chain_matrix(skeleton)
        self.start()

    def start(self) -> None:
        """Forget where the character stood, which way it faced, and its bones."""
        self._root = np.zeros(3)
        self._yaw = np.array(0.0)
        self._bones = self.body.rest_offsets.copy()

    def step(self, positions: Array, weights: Array) -> tuple[Array, HeadingFrame]:
        """Return a posture on the standard body, root at the origin, facing +z.

        A missing root or heading is that of the frame before; a joint whose parent is
        missing hangs on the parent's last known bone. Positions [m] are NaN where
        missing, shape (J, 3), weights (J,); the second result is the view taken out.
        """
        standard, view = self.steps(positions[None], weights[None])
        return standard[0], view.at(0)

    def steps(self, positions: Array, weights: Array) -> tuple[Array, HeadingFrame]:
        """Return the next frames, (T, J, 3) and (T, J), as ``step`` does one by one."""
        skeleton = self.body.skeleton
        missing = np.isnan(positions[..., 0])
        root = _held(positions[:, skeleton.root], self._root)
        yaw = _held(find_yaw(positions, weights, skeleton), self._yaw)
        view = HeadingFrame(root, yaw)
        seen = view.remove(positions)
        if missing.any():
            seen[:, skeleton.root] = 0.0
            for j in skeleton.order[1:]:
                parent = seen[:, skeleton.parents[j]]
                bone = np.where(missing[:, j, None], np.nan, seen[:, j] - parent)
                seen[:, j] = parent + _held(bone, self._bones[j])
        bones = self._bones_of(seen)
        self._root, self._yaw, self._bones = root[-1], yaw[-1], bones[-1]
        standard = self._chain @ _apply(self._to_standard, bones)
        standard[missing] = np.nan
        return standard, view

    def standardize(self, positions: Array, view: HeadingFrame) -> Array:
        """Return postures (..., J, 3) in world frame on the standard body, as ``step``.

        The root may be elsewhere than the view's, and stays as far from the origin. A
        missing joint takes what hangs on it along.
        """
        bones = self._bones_of(view.remove(positions))
        lost = np.isnan(bones)
        standard = self._chain @ _apply(self._to_standard, np.where(lost, 0.0, bones))
        missing = (self._chain @ lost.astype(float)) > 0.0
        return np.where(missing, np.nan, standard)

    def undo(self, positions: Array, view: HeadingFrame) -> Array:
        """Return standard postures (..., J, 3) on the person's body in their view."""
        bones = _apply(self._to_person, self._bones_of(positions))
        return view.restore(self._chain @ bones)

    def _bones_of(self, positions: Array) -> Array:
        """Return the vector to each joint from its parent, the root's from 0."""
        skeleton = self.body.skeleton
        bones = positions.copy()
        bones[..., skeleton.segments, :] -= positions[..., skeleton.segment_parents, :]
        return bones


def _apply(matrices: Array, bones: Array) -> Array:
    return np.asarray((matrices @ bones[..., None])[..., 0])


def _held(values: Array, before: Array) -> Array:
    """Return values (T, ...) with what came before in the place of NaN."""
    there = ~np.isnan(values).reshape(len(values), -1)[:, 0]
    if there.all():
        return values
    last = np.maximum.accumulate(np.where(there, np.arange(1, len(values) + 1), 0))
    return np.concatenate([before[None], values])[last]


def chain_matrix(skeleton: Skeleton) -> Array:
    """Return the matrix that sums bones from the root to every joint, (J, J)."""
    chain = np.zeros((len(skeleton), len(skeleton)))
    chain[skeleton.root, skeleton.root] = 1.0
    for j in skeleton.order[1:]:
        chain[j] = chain[skeleton.parents[j]]
        chain[j, j] = 1.0
    return chain
