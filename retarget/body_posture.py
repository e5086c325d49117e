"""The posture of a body from joint positions: bones of its lengths, then rotations.

Joints move as little as possible for their bones; rotations include twist.
"""

from functools import lru_cache

import numpy as np

from kinefilter.characters import Body, InputError, Skeleton
from kinefilter.characters.arrays import Array, Flags, chunks, solved
from kinefilter.characters.rotations import about_x, between, inverse, multiply, rotate

_CHUNK = 2048  # frames at a time, to bound the memory
_MOST_STEPS = 40
_EXACT = 1e-7  # m
_RECONSTRUCTED = 0.02  # firmness, 1 of a measured joint: fifty times the move. A guess.
# Factor on the firmness of hips, shoulders and their middles, on which all else
# depends. This and the next two were chosen on four of six recorded people;
# that bones do not resist twice as much was decided on all six.
_TRUNK = 30.0
# Resistance of a bone between measured joints to being turned, 1 of a measured joint
# to being moved. Without it, a leg that is too short for its bones bends at the knee.
_DIRECTION = 2.0
# Ease with which all above the knees moves as one, relative to a measured joint of a
# limb. Without it, legs that get longer push heels down, which drag.
_TOGETHER = 0.1


class BoneLengths:
    """Projection of postures onto the segment lengths of a body.

    Newton's method solves all length constraints at once, like SHAKE (Ryckaert,
    Ciccotti & Berendsen 1977, J. Comput. Phys. 23), with the step that moves joints
    and turns bones least. Where it does not converge, bones keep their directions and
    are chained from the root.
    """

    def __init__(self, body: Body) -> None:
        skeleton = self._skeleton = body.skeleton
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._lengths = body.lengths[self._ends]
        self._rest = body.directions[self._ends]
        self._ridge = 1e-9 * np.eye(len(self._ends))
        joints = np.eye(len(skeleton))
        self._incidence = joints[self._ends] - joints[self._starts]
        above = np.ones(len(skeleton))
        above[skeleton.legs] = 0.0
        self._together = _TOGETHER * np.outer(above, above)
        self._firm = np.ones(len(skeleton))
        trunk = [skeleton.root, skeleton.girdle, *skeleton.hips]
        self._firm[[*trunk, *skeleton.sides("Shoulder")]] = _TRUNK

    def project(self, positions: Array, firmness: Array) -> Array:
        """Return positions [m] (T, J, 3) with the body's segment lengths.

        Firmness (T, J) is a joint's resistance to being moved: 0 if reconstructed, 1 if
        measured, more if it is to stay. Raises an InputError if a joint is missing.
        """
        if not np.isfinite(positions).all():
            raise InputError("positions are not finite; fill in missing joints first")
        projected = positions.copy()
        for chunk in chunks(len(positions), _CHUNK):
            projected[chunk] = self._project(positions[chunk], firmness[chunk])
        return projected

    def fitted_lengths(self, positions: Array, firmness: Array) -> Array:
        """Return the segment lengths [m] (J,) for which joints move the least.

        This is a least-squares fit over all frames; arguments are those of ``project``.
        Errors above a quarter of a bone are the tracker's, and are clipped.
        """
        directions, errors = self._bones(positions)
        coupling = self._stretches(self._moves(firmness))
        coupling *= directions @ directions.transpose(0, 2, 1)
        weights = np.linalg.inv(coupling + self._ridge)
        near = np.clip(errors, -0.25 * self._lengths, 0.25 * self._lengths)
        pull = (weights @ near[..., None]).sum(axis=0)
        lengths = np.zeros(self._incidence.shape[1])
        lengths[self._ends] = self._lengths
        lengths[self._ends] += np.linalg.solve(weights.sum(axis=0), pull)[:, 0]
        return lengths

    def _moves(self, firmness: Array) -> Array:
        """Return the move of each joint per change of each bone, (T, bones, J)."""
        firm = self._firm * firmness + _RECONSTRUCTED
        turning = np.minimum(firm.take(self._ends, 1), firm.take(self._starts, 1))
        turning = _DIRECTION * np.minimum(turning, 1.0)
        resistance = np.zeros((*firm.shape, firm.shape[1]))
        resistance[:, self._ends, self._starts] = -turning
        resistance[:, self._starts, self._ends] = -turning
        joints = np.arange(firm.shape[1])
        resistance[:, joints, joints] = firm + turning @ np.abs(self._incidence)
        return np.asarray(
            self._incidence @ (np.linalg.inv(resistance) + self._together)
        )

    def _stretches(self, moves: Array) -> Array:
        """Return the difference of moves between both ends of each bone."""
        return moves.take(self._ends, -1) - moves.take(self._starts, -1)

    def _project(self, points: Array, firmness: Array) -> Array:
        projected, most = points.copy(), 0.5 * self._lengths
        directions, errors = self._bones(points)
        worst = np.abs(errors).max(axis=1)
        frames = np.flatnonzero(worst >= _EXACT)
        if not len(frames):
            return projected
        moves = self._moves(firmness[frames])
        coupling = self._stretches(moves)
        share = np.ones((len(frames), 1, 1))
        points, directions, errors, worst = (
            values[frames] for values in (points, directions, errors, worst)
        )
        for _ in range(_MOST_STEPS):
            system = coupling * (directions @ directions.transpose(0, 2, 1))
            system += self._ridge
            # Steps of at most half a bone keep a folded limb from flipping over.
            step = np.minimum(np.maximum(errors, -most), most)
            pull = solved(system, step[..., None]) * directions
            tried = points - share * (moves.transpose(0, 2, 1) @ pull)
            new_directions, new_errors = self._bones(tried)
            new_worst = np.abs(new_errors).max(axis=1)
            # Frames that do not improve try again with half the step.
            better = (new_worst < worst)[:, None, None]
            if better.all():
                points, directions, errors = tried, new_directions, new_errors
                share = np.minimum(2.0 * share, 1.0)
            else:
                share = np.where(better, np.minimum(2.0 * share, 1.0), share / 2.0)
                points = np.where(better, tried, points)
                directions = np.where(better, new_directions, directions)
                errors = np.where(better[..., 0], new_errors, errors)
            worst = np.minimum(new_worst, worst)
            exact = worst < _EXACT
            if exact.any():
                projected[frames[exact]] = points[exact]
                if exact.all():
                    return projected
                left = (frames, points, directions, errors, worst)
                frames, points, directions, errors, worst = (x[~exact] for x in left)
                moves, coupling, share = (x[~exact] for x in (moves, coupling, share))
        bones = directions * self._lengths[:, None]
        for k, (j, p) in enumerate(zip(self._ends, self._starts, strict=True)):
            points[:, j] = points[:, p] + bones[:, k]
        projected[frames] = points
        return projected

    def _bones(self, points: Array) -> tuple[Array, Array]:
        """Return unit directions (of zero bones: at rest) and length errors [m]."""
        bones = self._skeleton.bones(points)
        lengths = np.sqrt(np.vecdot(bones, bones))
        errors = lengths - self._lengths
        if lengths.min(initial=1.0) > 1e-6:
            return bones / lengths[..., None], errors
        valid = (lengths > 1e-6)[..., None]
        directions = bones / np.where(valid, lengths[..., None], 1.0)
        return np.where(valid, directions, self._rest), errors


_NO_PLANE = 1e-9  # m^2
_X, _UNTURNED = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])


def rotations_from_positions(
    positions: Array, body: Body, prior: Array | None = None
) -> Array:
    """Return segment rotations, wxyz (..., J, 4), from joint positions (..., J, 3).

    Positions do not determine the twist about each bone. It comes from the prior
    (rotations of a similar posture; in Shum 2013, section VII.B, the neighbors in the
    posture database), turned by the smallest rotation that aligns its bone; without a
    prior, it comes from the parent segment, turned likewise.
    """
    skeleton, rest = body.skeleton, body.rest_offsets
    rotations = np.empty((*positions.shape[:-1], 4))
    pelvis, plane = _pelvis_frame(positions, skeleton)
    pelvis = multiply(pelvis, _from_rest_pelvis(body))
    rotations[..., skeleton.root, :] = np.where(plane[..., None], pelvis, _UNTURNED)
    if prior is not None:
        ends = skeleton.segments
        turns, bones = prior.take(ends, -2), skeleton.bones(positions)
        rotations[..., ends, :] = _aligned(turns, rest[ends], bones)
        return rotations
    for ends, starts in skeleton.generations:
        bones = positions.take(ends, -2) - positions.take(starts, -2)
        turns = rotations.take(starts, -2)
        rotations[..., ends, :] = _aligned(turns, rest[ends], bones)
    return rotations


def fill_missing_joints(positions: Array, body: Body) -> Array:
    """Return postures with missing (NaN) joints placed by their parents, as at rest."""
    skeleton, filled = body.skeleton, positions.copy()
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        missing = ~np.isfinite(filled[..., j, :]).all(axis=-1, keepdims=True)
        if missing.any():
            turns = rotations_from_positions(filled, body)[..., p, :]
            placed = filled[..., p, :] + rotate(turns, body.rest_offsets[j])
            filled[..., j, :] = np.where(missing, placed, filled[..., j, :])
    return filled


def _aligned(rotation: Array, rest: Array, bone: Array) -> Array:
    return multiply(between(rotate(rotation, rest), bone), rotation)


@lru_cache(maxsize=4)
def _from_rest_pelvis(body: Body) -> Array:
    return inverse(_pelvis_frame(body.rest_positions, body.skeleton)[0])


def _pelvis_frame(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags]:
    """Return the rotation to x through the hips and y toward the spine.

    The flags are False where the two do not span a plane, so that it is arbitrary.
    """
    left, right = skeleton.hips
    (spine,) = (c for c in skeleton.children[skeleton.root] if c not in (left, right))
    x = positions[..., left, :] - positions[..., right, :]
    up = positions[..., spine, :] - positions[..., skeleton.root, :]
    turned = between(_X, x)
    # What remains is the angle about x from the turned y axis to up.
    local = rotate(inverse(turned), up)
    # Copies, because the rounding of arctan2 depends on the memory layout of a view.
    y, z = local[..., 1].copy(), local[..., 2].copy()
    frame = multiply(turned, about_x(np.arctan2(z, y)))
    plane = np.sum(x * x, axis=-1) * (y**2 + z**2) > _NO_PLANE**2
    return frame, np.asarray(plane)
