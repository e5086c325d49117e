"""The tilt and roll of a sensor, from how people stand and walk before it.

Most sensors look down a little, and many stand a degree or two askew. Feet show both,
as they get lower or higher where people walk away or across, and leans show the tilt:
whoever walks or stands is upright on average, apart from a lean of their own, which
turns with them. All of it is one linear least squares problem with a prior for each
unknown, and its sums grow frame by frame.

Joint positions [m] have y up, in the frame of the sensor, and shape (T, J, 3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.upright import NEAREST, posture_of
from kinefilter.retarget import find_yaw

from .feet import ankles_and_toes

# Unknowns: the sensor's tilt and roll, how far it shows everybody leaning to its side,
# and the lean away from it that it adds [rad]; each person's lean forward and to the
# left [rad], the height of their ankles at the sensor, and by how much the left one
# seems higher than that [m]. Leans to the side do not count for the roll: they made
# that of people who only stand no more exact. By marker mocap of six people (UI-PRMD)
# who stand, the center of mass is 2.1 to 4.6 degrees in front of the ankles. Constants
# were chosen on p00 to p08 of two-kinects and on CMU's people 02 to 32 before a virtual
# Kinect, where twice or half of each hardly matters.
_SHARED, _OWN = 4, 4
_MEANS = np.radians([0.0, 0.0, 0.0, 0.7, 3.0, 0.0, 0.0, 0.0])
_DEVIATIONS = np.append(np.radians([7.0, 1.5, 1.5, 0.5, 1.2, 1.0]), [3.0, 0.02])
_LEAN, _HEIGHT = 0, 1  # the kinds of evidence
# Standard deviations [rad, m] of a person's noise, until more than a time [s] shows it.
_USUAL_NOISE, _USUAL_TIME = np.array([np.radians(4.0), 0.05]), 2.0
_BETWEEN = np.array([1.0, 0.5])  # s between two independent samples
_ROUNDS = 3  # in which the noise is found
_RAISED = 0.1  # m above the other ankle: that foot does not bear the person
_APART = 0.3  # m between two feet that bear, with which leans count half
_UPRIGHT = 0.85  # share of a leg's length by which the hip is above a foot that bears
_MOST_LEAN = np.radians(25.0)  # who leans farther does not stand
_MOST_TILT = np.radians(15.0)  # what is more is found by ``upright``


class TiltEvidence:
    """What one person shows of the sensor's tilt.

    Attributes:
        products: Sums over rows of each kind of evidence, weighted by the time [s] that
            each stands for: outer products of the row with itself, (2, 9, 9). A row has
            a factor for each unknown and, last, what they add up to: a lean or a
            height.
        seconds: Sums of these times, (2,).
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton, (self._ankles, _) = skeleton, ankles_and_toes(skeleton)
        legs = [skeleton.sides(part) for part in ("Hip", "Knee", "Ankle")]
        self._legs = np.array(legs)
        size = _SHARED + _OWN + 1
        self.products, self.seconds = np.zeros((2, size, size)), np.zeros(2)

    def add(self, positions: Array, confidence: Array, elapsed: Array) -> None:
        """Add frames, each of which stands for a time [s], (T,); confidence (T, J)."""
        seen, leg = confidence[:, self._ankles] >= 0.5, positions[:, self._legs]
        low = np.where(seen, leg[:, -1, :, 1], np.inf)
        some, lower = seen.any(axis=1), low.argmin(axis=1)
        leg = leg[np.arange(len(leg)), :, lower]
        # A foot that alone is seen may be in the air, but not below a straight leg.
        length = np.linalg.norm(np.diff(leg, axis=1), axis=2).sum(axis=1)
        some &= leg[:, 0, 1] - leg[:, -1, 1] > _UPRIGHT * length
        foot, both = leg[some, -1], some & seen.all(axis=1)
        nothing, one = np.zeros(len(foot)), np.ones(len(foot))
        side = 1.0 - 2.0 * lower[some]
        rows = [foot[:, 2], -foot[:, 0], *[nothing] * 4, one, side, foot[:, 1]]
        self._add(_HEIGHT, np.transpose(rows), elapsed[some])
        self._add_leans(positions[both], elapsed[both])

    def _add_leans(self, positions: Array, elapsed: Array) -> None:
        """Add what frames in which both ankles are seen say of who stands upright."""
        feet, skeleton = positions[:, self._ankles], self._skeleton
        bears = feet[..., 1] < feet[..., 1].min(axis=1, keepdims=True) + _RAISED
        below = np.mean(feet, axis=1, where=bears[..., None])
        trunk = positions[:, [skeleton.root, skeleton.girdle]].mean(axis=1)
        x, y, z = (trunk - below).T
        leans = np.arctan2([z, x], y)
        yaw = find_yaw(positions, skeleton)
        place = positions[:, skeleton.root][:, [0, 2]]
        _, straight, _ = posture_of(positions, skeleton)
        stands = (straight & bears).any(axis=1) & np.isfinite(yaw)
        stands &= np.abs(leans).max(axis=0) < _MOST_LEAN
        stands &= np.linalg.norm(place, axis=1) > NEAREST
        # Between feet that are apart, the trunk may be anywhere.
        apart = (feet[:, 0] - feet[:, 1])[stands].T * bears[stands].all(axis=1)
        weights = elapsed[stands] / (1.0 + (apart / _APART) ** 2)
        away_x, away_z = unit(place[stands]).T
        sine, cosine = np.sin(yaw[stands]), np.cos(yaw[stands])
        none, one = np.zeros_like(sine), np.ones_like(sine)
        deep, across = leans[:, stands]
        rows = [-one, none, none, away_z, cosine, -sine, none, none, deep]
        self._add(_LEAN, np.transpose(rows), weights[2])
        rows = [none, none, one, away_x, sine, cosine, none, none, across]
        self._add(_LEAN, np.transpose(rows), weights[0])

    def _add(self, kind: int, rows: Array, elapsed: Array) -> None:
        self.products[kind] += (rows * elapsed[:, None]).T @ rows
        self.seconds[kind] += elapsed.sum()


def sensor_tilt(people: Sequence[TiltEvidence], *, by_kinect: bool = True) -> Array:
    """Return the angles [rad] about x and z that level the floor, 0 if unknown, (2,).

    People of a recording share them. The sensor misplaces the feet of each by a height
    of their own. An estimate below its standard error counts as 0, and counts fully
    only above twice that error. Leans count only before a Kinect.
    """
    size = _SHARED + _OWN * len(people)
    shared = list(range(_SHARED))
    own = [[*shared, *range(k, k + _OWN)] for k in range(_SHARED, size, _OWN)]
    means, precision = np.zeros(size), np.zeros((size, size))
    for unknowns in own:
        means[unknowns] = _MEANS
        precision[unknowns, unknowns] = _DEVIATIONS**-2.0
    used = np.array([by_kinect, True])
    noise = np.tile(_USUAL_NOISE, (len(people), 1))
    for _ in range(_ROUNDS):
        left, right = precision.copy(), precision @ means
        for person, unknowns, deviations in zip(people, own, noise, strict=True):
            weights = used / (_BETWEEN * deviations**2)
            total = np.tensordot(weights, person.products, 1)
            left[np.ix_(unknowns, unknowns)] += total[:-1, :-1]
            right[unknowns] += total[:-1, -1]
        found = np.linalg.solve(left, right)
        for k, (person, unknowns) in enumerate(zip(people, own, strict=True)):
            signs = np.append(found[unknowns], -1.0)
            squares = np.einsum("i,kij,j->k", signs, person.products, signs)
            squares = np.maximum(squares, 0.0) + _USUAL_TIME * _USUAL_NOISE**2
            noise[k] = np.sqrt(squares / (person.seconds + _USUAL_TIME))
    errors = np.sqrt(np.diag(np.linalg.inv(left))[:2])
    angles = found[:2].clip(-_MOST_TILT, _MOST_TILT)
    return np.asarray(angles * (abs(angles) / errors - 1.0).clip(0.0, 1.0))
