"""Direction of the head from all joints above the shoulders."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, multiply, rotate, unit

from .straight_chain import StraightChains

_STRAIGHT = 0.5  # weight of a straight neck; chosen as those of ``palms``
_BEND = (np.radians(50.0), np.radians(70.0))  # Norkin & White 2016: 45 to 80
_NECK_SHARE = 0.4  # of the head's bend


class Neck(StraightChains):
    """Neck and head of a body, which share their bend."""

    def __init__(self, body: Body) -> None:
        skeleton = body.skeleton
        chain = skeleton.ancestors(skeleton.index("Head"))[::-1]
        chain = chain[chain.index(skeleton.girdle) + 1 :]
        rows = [[joint] for joint in chain]
        start = [skeleton.girdle]
        super().__init__(body, start, rows, straight=_STRAIGHT, bend=_BEND)
        self._body = body

    def posed(
        self, positions: Array, rotations: Array, heads: Array
    ) -> tuple[Array, Array]:
        """Return positions and rotations with neck and head turned.

        ``heads`` (..., 1, 3) is the head's unit direction in the frame of the chest.
        Neck and head keep their twist.
        """
        positions, rotations = positions.copy(), rotations.copy()
        chest, before = rotations[..., self.starts, :], self.starts
        for joints in self.joints:
            last = joints == self.joints[-1]
            share = 1.0 if last else _NECK_SHARE
            local = unit(share * heads + (1.0 - share) * self.along)
            rest, turns = self._body.rest_offsets[joints], rotations[..., joints, :]
            turn = between(rotate(turns, rest), rotate(chest, local))
            rotations[..., joints, :] = turns = multiply(turn, turns)
            positions[..., joints, :] = positions[..., before, :] + rotate(turns, rest)
            before = joints
        return positions, rotations
