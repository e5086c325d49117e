"""Move joints the least that gives every bone its length."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array, chunks

_CHUNK = 2048  # frames at a time, to bound the memory
_MOST_STEPS = 40
_EXACT = 1e-7  # m
# Against a measured joint's 1: it moves fifty times as far. A guess.
_FIRMNESS_OF_INVENTED = 0.02
# Chosen on three of six recorded people, as is the next.
_TRUNK = 10.0  # times as firm: hips, shoulders and their middles, which all hangs on
# Against a measured limb joint's 1, how easily all above the knees moves as one.
# Without it legs that are too long or short push the hips out from under the trunk.
_TOGETHER = 0.5


class BoneLengths:
    """Projects postures onto the segment lengths of a body.

    Newton's method on the length constraints with the shortest step, as SHAKE solves
    them (Ryckaert, Ciccotti & Berendsen 1977, J. Comput. Phys. 23), all at once; where
    that does not get there, bones keep their directions and are laid from the root on.
    """

    def __init__(self, body: Body) -> None:
        skeleton = body.skeleton
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._lengths = body.lengths[self._ends]
        self._longest = 0.5 * self._lengths
        self._rest = body.directions[self._ends]
        self._ridge = 1e-9 * np.eye(len(self._ends))
        self._incidence = np.zeros((len(self._ends), len(skeleton)))
        rows = np.arange(len(self._ends))
        self._incidence[rows, self._ends] = 1.0
        self._incidence[rows, self._starts] = -1.0
        above = np.ones(len(skeleton))
        for hip in skeleton.hips:
            above[skeleton.beyond(int(hip))] = 0.0
        self._together = _TOGETHER * np.outer(self._incidence @ above, above)
        self._firm = np.ones(len(skeleton))
        middles = [skeleton.root, skeleton.girdle]
        self._firm[[*middles, *skeleton.hips, *skeleton.sides("Shoulder")]] = _TRUNK

    def project(self, positions: Array, firmness: Array) -> Array:
        """Return positions [m] (T, J, 3) with the body's segment lengths.

        Firmness (T, J) is how hard each joint is to move: 0 for an invented one, 1 for
        a measured one, more for what is to stay. Raises InputError if a joint is
        missing.
        """
        if not np.isfinite(positions).all():
            raise InputError("positions are not finite; fill missing joints")
        projected = positions.copy()
        for chunk in chunks(len(positions), _CHUNK):
            projected[chunk] = self._project(positions[chunk], firmness[chunk])
        return projected

    def fitting(self, positions: Array, firmness: Array) -> Array:
        """Return segment lengths [m] (J,) for which joints move the least.

        Least squares over all frames; arguments are as of ``project``. A length counts
        as a quarter off the body's at most: what is farther off is a tracker's error.
        """
        directions, errors = self._bones(positions)
        coupling = self._moves(firmness) @ self._incidence.T
        coupling *= directions @ directions.transpose(0, 2, 1)
        weights = np.linalg.inv(coupling + self._ridge)
        near = np.clip(errors, -0.25 * self._lengths, 0.25 * self._lengths)
        pull = (weights @ near[..., None]).sum(axis=0)
        lengths = np.zeros(self._incidence.shape[1])
        lengths[self._ends] = self._lengths
        lengths[self._ends] += np.linalg.solve(weights.sum(axis=0), pull)[:, 0]
        return lengths

    def _moves(self, firmness: Array) -> Array:
        """Return how each joint moves for each bone, shape (T, bones, J)."""
        firm = self._firm * firmness + _FIRMNESS_OF_INVENTED
        return np.asarray(self._incidence / firm[:, None, :] + self._together)

    def _project(self, points: Array, firmness: Array) -> Array:
        moves = self._moves(firmness)
        coupling = moves @ self._incidence.T
        moves = moves.transpose(0, 2, 1)
        share = np.ones((len(points), 1, 1))
        directions, errors = self._bones(points)
        worst = np.abs(errors).max(axis=1)
        for _ in range(_MOST_STEPS):
            if worst.max() < _EXACT:
                break
            system = coupling * (directions @ directions.transpose(0, 2, 1))
            system += self._ridge
            # A step half as long as a bone keeps a folded limb from flipping over.
            wanted = np.maximum(np.minimum(errors, self._longest), -self._longest)
            pull = np.linalg.solve(system, wanted[..., None]) * directions
            tried = points - share * (moves @ pull)
            found, wrong = self._bones(tried)
            left = np.abs(wrong).max(axis=1)
            # What does not come nearer is tried again with half the step.
            better = (left < worst)[:, None, None]
            share = np.where(better, np.minimum(2 * share, 1), share / 2)
            points = np.where(better, tried, points)
            directions = np.where(better, found, directions)
            errors = np.where(better[..., 0], wrong, errors)
            worst = np.minimum(left, worst)
        exact = worst < _EXACT
        if exact.all():
            return points
        walked, bones = points.copy(), directions * self._lengths[:, None]
        for k, (j, p) in enumerate(zip(self._ends, self._starts, strict=True)):
            walked[:, j] = walked[:, p] + bones[:, k]
        return np.where(exact[:, None, None], points, walked)

    def _bones(self, points: Array) -> tuple[Array, Array]:
        """Return unit directions and length errors [m]; no length: as at rest."""
        bones = points[:, self._ends] - points[:, self._starts]
        lengths = np.sqrt(np.vecdot(bones, bones))
        there = (lengths > 1e-6)[..., None]
        directions = bones / np.where(there, lengths[..., None], 1.0)
        return np.where(there, directions, self._rest), lengths - self._lengths
