"""Directions of hands and twist of forearms, from all joints beyond the wrists."""

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_x,
    between,
    cross,
    inverse,
    multiply,
    rotate,
    unit,
)

from .straight_chain import StraightChains, softened

# Chosen on 24 simulated takes, half of them with hands that bend and turn.
_STRAIGHT = 0.25  # weight of a straight hand; a reliable one has 1
_UNTWISTED = 0.7  # weight of the forearm's rotation; a reliable thumb has 1
# People use 54 to 60 degrees of their wrists (Ryu et al. 1991, J. Hand Surg. 16A).
_BEND = np.radians(40.0), joint_range("HandLeft") - np.radians(1.0)
_TWIST = np.radians((60.0, 80.0))  # pronation and supination (Norkin & White 2016)


class Palms(StraightChains):
    """Hands of a body, straight from wrist to finger tips, with their thumbs.

    Arrays have a row for the left and the right hand. No wrist bends by 55 degrees or
    more. Without thumbs, the forearm has the twist of its segment's rotation.
    """

    def __init__(self, body: Body) -> None:
        skeleton, wrists = body.skeleton, body.skeleton.sides("Wrist")
        hand = [skeleton.joints[j] for j in skeleton.descendants(wrists[0])]
        stems = [joint.removesuffix("Left") for joint in hand]
        fingers = [skeleton.sides(stem) for stem in stems if stem != "Thumb"]
        super().__init__(body, wrists, fingers, straight=_STRAIGHT, bend=_BEND)
        self._thumbs = skeleton.sides("Thumb") if "Thumb" in stems else []
        if self._thumbs:
            rest = body.rest_offsets[self._thumbs]
            ahead = unit(rest - np.vecdot(rest, self.along)[:, None] * self.along)
            sides = np.stack([ahead, cross(self.along, ahead)], axis=1)
            self._sides = sides / np.vecdot(rest, ahead)[:, None, None]
        self._beyond = np.array([skeleton.sides(stem) for stem in stems])
        places = body.rest_positions
        self._offsets = places[self._beyond] - places[self.starts]

    @property
    def has_thumbs(self) -> bool:
        """Whether the skeleton has thumbs, which show the twist of forearms."""
        return bool(self._thumbs)

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
        local = rotate(inverse(rotations[..., self.starts, :]), bones)
        local = rotate(between(hands, self.along), local)
        seen = np.vecdot(local[..., None, :], self._sides)
        return seen, weights[..., self._thumbs]

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
