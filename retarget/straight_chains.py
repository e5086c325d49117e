"""Hands and neck as chains of short bones that are taken for one straight segment.

Their bones are hardly longer than a tracker's errors, so none of them shows where it
points. Together they do: joints count by their distance from the start of the chain,
and where none is reliable, the chain continues the segment before it.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_x,
    about_y,
    between,
    cross,
    inverse,
    multiply,
    rotate,
    unit,
)

# ``_ODD`` and the weights of hands were chosen on 24 simulated takes, half of them with
# hands that bend and turn, the weight of heads as RESULTS says. Ranges of neck and
# forearm: Norkin & White 2016. Those of palms: people use 54 to 60 degrees of their
# wrists (Ryu et al. 1991, J. Hand Surg. 16A).
_ODD = 1.2  # distance from a straight chain, relative to length, that halves its weight
_NECK_SHARE = 0.4  # of the head's bend and turn
_AHEAD = 0.1  # weight of a face that looks ahead; a seen one has 1. A guess
_TURN = np.radians((60.0, 80.0))  # of the face
_UNTWISTED = 0.7  # weight of the forearm's rotation; a reliable thumb has 1
_TWIST = np.radians((60.0, 80.0))  # of forearms: pronation and supination


class _StraightChains:
    """Chains that each start at a joint, in the frame of the segment that ends there.

    ``starts`` are the joints at which the K chains start, ``joints`` for each place
    along the chains the K joints there.
    """

    _straight: ClassVar[float]  # weight of a straight chain; a reliable one has 1
    _bend: ClassVar[tuple[float, float]]
    """Angles [rad] to which chains bend freely, and that they never reach."""

    def __init__(
        self, body: Body, starts: Sequence[int], joints: Sequence[Sequence[int]]
    ) -> None:
        self.starts, self.joints = np.array(starts), np.array(joints)
        self.along = body.directions[self.joints[0]]
        self._reach = np.cumsum(body.lengths[self.joints], axis=0)
        self._whole = np.sum(self._reach**2, axis=0)

    def aims(
        self, positions: Array, rotations: Array, weights: Array
    ) -> tuple[Array, Array]:
        """Return where chains point, and how reliably, in [0, 1] for weights up to 1.

        Arguments are joint positions [m] (..., J, 3), world rotations of the segments,
        wxyz (..., J, 4), and the weight of each joint, above 0, (..., J). Results are
        least-squares directions in the frames of the segments before, (..., K, 3),
        shorter than 1 as far as the joints disagree, and their weights, (..., K), less
        for chains that bend far, most of which the tracker has lost.
        """
        starts = positions.take(self.starts, -2)
        bones = positions.take(self.joints, -2) - starts[..., None, :, :]
        pulls = weights[..., self.joints] * self._reach
        total = (pulls * self._reach).sum(axis=-2)
        mean = (pulls[..., None] * bones).sum(axis=-3) / total[..., None]
        aims = rotate(inverse(rotations.take(self.starts, -2)), mean)
        bent = aims - self.along
        odd = np.vecdot(bent, bent) / _ODD**2
        return aims, total / self._whole / (1.0 + odd)

    def straightened(self, aims: Array, weights: Array) -> Array:
        """Return unit directions (..., K, 3) from ``aims`` for chains that resist."""
        mixed = unit(weights[..., None] * aims + self._straight * self.along)
        bend = np.arccos(np.vecdot(mixed, self.along).clip(-1.0, 1.0))
        away = unit(mixed - np.cos(bend)[..., None] * self.along)
        less = softened(bend, *self._bend)[..., None]
        return np.asarray(np.cos(less) * self.along + np.sin(less) * away)


def softened(angle: Array, free: Array | float, most: Array | float) -> Array:
    """Return angles or lengths that stay to ``free`` and never reach ``most``."""
    room, size = most - free, np.abs(angle)
    less = free + room * np.tanh((size - free) / room)
    return np.where(size > free, np.sign(angle) * less, angle)


class Neck(_StraightChains):
    """Neck and head of a body, which share their bend, and the turn of the face."""

    _straight, _bend = 0.15, (np.radians(50.0), np.radians(70.0))

    def __init__(self, body: Body) -> None:
        skeleton = body.skeleton
        chain = skeleton.ancestors(skeleton.index("Head"))[::-1]
        chain = chain[chain.index(skeleton.girdle) + 1 :]
        super().__init__(body, [skeleton.girdle], [[joint] for joint in chain])
        self._body = body

    def faces(self, face: Array, rotations: Array, head: Array) -> Array:
        """Return where a face looks around the head's axis, shape (..., 1, 2).

        The coordinates are to the left and ahead, as parts of ``face`` (..., 3), a unit
        vector in the world, after the neck's bend is undone. Other arguments are those
        of ``posed``.
        """
        local = rotate(inverse(rotations.take(self.starts, -2)), face[..., None, :])
        return rotate(between(head, self.along), local)[..., [0, 2]]

    def turn(self, faces: Array, weights: Array) -> Array:
        """Return how far heads turn to the left [rad], (..., 1), within 80 degrees.

        ``weights`` (..., 1) are those of ``faces``, 1 where the face is seen.
        """
        left, ahead = np.moveaxis(weights[..., None] * faces, -1, 0)
        return softened(np.arctan2(left, ahead + _AHEAD), *_TURN)

    def posed(
        self, positions: Array, rotations: Array, head: Array, turn: Array | None = None
    ) -> tuple[Array, Array]:
        """Return positions and rotations with neck and head bent, and turned.

        ``head`` (..., 1, 3) is the head's unit direction in the frame of the chest,
        ``turn`` (..., 1) the angle [rad] to the left between face and chest. Without
        it, neck and head keep their twist.
        """
        positions, rotations = positions.copy(), rotations.copy()
        chest, before = rotations[..., self.starts, :], self.starts
        for k, joints in enumerate(self.joints, start=1):
            share = 1.0 if k == len(self.joints) else _NECK_SHARE
            local = unit(share * head + (1.0 - share) * self.along)
            rest, turns = self._body.rest_offsets[joints], rotations[..., joints, :]
            if turn is not None:
                turns = multiply(chest, about_y(share * turn))
            bend = between(rotate(turns, rest), rotate(chest, local))
            rotations[..., joints, :] = turns = multiply(bend, turns)
            positions[..., joints, :] = positions[..., before, :] + rotate(turns, rest)
            before = joints
        return positions, rotations


class Palms(_StraightChains):
    """Hands of a body, straight from wrist to finger tips, with their thumbs.

    Arrays have a row for the left and the right hand. No wrist bends by 55 degrees or
    more. Without thumbs, the forearm has the twist of its segment's rotation.
    """

    _straight = 0.25
    _bend = np.radians(40.0), joint_range("HandLeft") - np.radians(1.0)

    def __init__(self, body: Body) -> None:
        skeleton, wrists = body.skeleton, body.skeleton.sides("Wrist")
        hand = [skeleton.kinds[j] for j in skeleton.descendants(wrists[0])]
        fingers = [skeleton.sides(kind) for kind in hand if kind != "Thumb"]
        super().__init__(body, wrists, fingers)
        self.has_thumbs = "Thumb" in hand  # which show the twist of forearms
        if self.has_thumbs:
            self._thumbs = skeleton.sides("Thumb")
            rest = body.rest_offsets[self._thumbs]
            ahead = unit(rest - np.vecdot(rest, self.along)[:, None] * self.along)
            sides = np.stack([ahead, cross(self.along, ahead)], axis=1)
            self._sides = sides / np.vecdot(rest, ahead)[:, None, None]
        self._beyond = np.array([skeleton.sides(kind) for kind in hand])
        places = body.rest_positions
        self._offsets = places[self._beyond] - places[self.starts]

    def thumbs(
        self, positions: Array, rotations: Array, weights: Array, hands: Array
    ) -> tuple[Array, Array]:
        """Return where thumbs are around the forearms, and their weights (..., 2).

        ``hands`` are the directions from ``straightened``; other arguments are as in
        ``aims``. Thumbs (..., 2, 2) are vectors from wrist to thumb across the forearm,
        after the wrist's bend is undone: toward the thumb's place at rest and at right
        angles to that, of length 1 at rest.
        """
        bones = positions[..., self._thumbs, :] - positions[..., self.starts, :]
        local = rotate(inverse(rotations.take(self.starts, -2)), bones)
        local = rotate(between(hands, self.along), local)
        return np.vecdot(local[..., None, :], self._sides), weights[..., self._thumbs]

    def twist(self, thumbs: Array, weights: Array) -> Array:
        """Return the twist [rad] of forearms from results of ``thumbs``, (..., 2).

        It is within 80 degrees: of a thumb on the far side, only the part across
        counts, as then the tracker has mostly lost it.
        """
        toward, across = np.moveaxis(weights[..., None] * thumbs, -1, 0)
        return softened(np.arctan2(across, np.abs(toward + _UNTWISTED)), *_TWIST)

    def posed(
        self, positions: Array, rotations: Array, hands: Array, twist: Array
    ) -> tuple[Array, Array]:
        """Return positions and rotations with forearms twisted and hands placed.

        ``hands`` (..., 2, 3) are unit directions in the frames of the forearms before
        these are twisted [rad] (..., 2). Fingers and thumbs are as at rest.
        """
        positions, rotations = positions.copy(), rotations.copy()
        forearms = rotations[..., self.starts, :]
        # Forearms of the T-pose point along x, to the left or to the right.
        twisted = multiply(forearms, about_x(twist * self.along[:, 0]))
        rotations[..., self.starts, :] = twisted
        along = rotate(forearms, self.along)
        turned = multiply(between(along, rotate(forearms, hands)), twisted)
        turned, wrists = turned[..., None, :, :], positions[..., None, self.starts, :]
        positions[..., self._beyond, :] = wrists + rotate(turned, self._offsets)
        rotations[..., self._beyond, :] = turned
        return positions, rotations
