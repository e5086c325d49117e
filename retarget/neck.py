"""Direction of the head from all joints above the shoulders, and of the face."""

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_y,
    between,
    inverse,
    multiply,
    rotate,
    unit,
)

from .straight_chain import StraightChains, softened

_STRAIGHT = 0.5  # weight of a straight neck; chosen as those of ``palms``
_BEND = (np.radians(50.0), np.radians(70.0))  # Norkin & White 2016: 45 to 80
_NECK_SHARE = 0.4  # of the head's bend and turn
_AHEAD = 0.1  # weight of a face that looks ahead; a seen one has 1. A guess
_TURN = (np.radians(60.0), np.radians(80.0))  # Norkin & White 2016: 49 to 80


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

    def faces(self, face: Array, rotations: Array, heads: Array) -> Array:
        """Return where a face looks around the head's axis, shape (..., 1, 2).

        The coordinates are to the left and ahead, as parts of ``face`` (..., 3), a unit
        vector in the world, after the neck's bend is undone. Other arguments are those
        of ``posed``.
        """
        local = rotate(inverse(rotations[..., self.starts, :]), face[..., None, :])
        return rotate(between(heads, self.along), local)[..., [0, 2]]

    def turn(self, faces: Array, weights: Array) -> Array:
        """Return how far heads turn to the left [rad], (..., 1), within 80 degrees.

        ``weights`` (..., 1) are those of ``faces``, 1 where the face is seen.
        """
        left, ahead = np.moveaxis(weights[..., None] * faces, -1, 0)
        return softened(np.arctan2(left, ahead + _AHEAD), *_TURN)

    def posed(
        self,
        positions: Array,
        rotations: Array,
        heads: Array,
        turn: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return positions and rotations with neck and head bent, and turned.

        ``heads`` (..., 1, 3) is the head's unit direction in the frame of the chest,
        ``turn`` (..., 1) the angle [rad] to the left between face and chest. Without
        it, neck and head keep their twist.
        """
        positions, rotations = positions.copy(), rotations.copy()
        chest, before = rotations[..., self.starts, :], self.starts
        for k, joints in enumerate(self.joints, start=1):
            share = 1.0 if k == len(self.joints) else _NECK_SHARE
            local = unit(share * heads + (1.0 - share) * self.along)
            rest, turns = self._body.rest_offsets[joints], rotations[..., joints, :]
            if turn is not None:
                turns = multiply(chest, about_y(share * turn))
            bend = between(rotate(turns, rest), rotate(chest, local))
            rotations[..., joints, :] = turns = multiply(bend, turns)
            positions[..., joints, :] = positions[..., before, :] + rotate(turns, rest)
            before = joints
        return positions, rotations
