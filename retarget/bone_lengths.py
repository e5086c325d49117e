"""Joint positions with a body's bone lengths: they move as little as possible."""

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array, chunks, solved

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
# Ease with which all above the knees moves as one. Without it, legs that get longer
# push heels down, which drag.
_TOGETHER = 0.1


class BoneLengths:
    """Projection of postures onto the segment lengths of a body.

    Newton's method solves all length constraints at once, like SHAKE (Ryckaert,
    Ciccotti & Berendsen 1977, J. Comput. Phys. 23), with the step that moves joints
    and turns bones least. Where it does not converge, bones keep their directions and
    are chained from the root. How easily all above the knees moves ``together`` is
    relative to a measured joint of a limb; ``above`` is 1 for these joints, 0 for
    others, shape (J,).
    """

    def __init__(self, body: Body, *, together: float = _TOGETHER) -> None:
        skeleton = self._skeleton = body.skeleton
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._lengths = body.lengths[self._ends]
        self._rest = body.directions[self._ends]
        self._ridge = 1e-9 * np.eye(len(self._ends))
        joints = np.eye(len(skeleton))
        self._incidence = joints[self._ends] - joints[self._starts]
        self.above = np.ones(len(skeleton))
        self.above[skeleton.legs] = 0.0
        self._together = together * np.outer(self.above, self.above)
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
