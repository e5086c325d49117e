"""Directions of hands and twist of forearms, from all joints beyond the wrists.

The bones beyond a wrist are hardly longer than a tracker's errors. Taken one by one,
they point anywhere; here, the palm with its fingers is one straight segment, and how
far its joints count depends on their distance from the wrist. Without them, the hand
extends the forearm, and the forearm has the twist of its segment's rotation.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_x,
    between,
    inverse,
    multiply,
    rotate,
    unit,
)

# Chosen on 24 simulated takes, half of them with hands that bend and turn.
_STRAIGHT = 0.25  # weight of a straight hand; a reliable one has 1
_UNTWISTED = 0.7  # weight of the forearm's rotation; a reliable thumb has 1
_ODD = 1.2  # distance from a straight hand, relative to length, that halves its weight
# Below the first angle a bend or twist stays as it is; it never reaches the second.
# People use 54 to 60 degrees of their wrists (Ryu et al. 1991, J. Hand Surg. 16A).
_BEND = np.radians(40.0), joint_range("HandLeft") - np.radians(1.0)
_TWIST = np.radians((60.0, 80.0))  # pronation and supination (Norkin & White 2016)


class Palms:
    """Hands of a body as straight segments, in the frames of its forearms.

    Arrays have a row for the left and the right hand.
    """

    def __init__(self, body: Body) -> None:
        skeleton = body.skeleton
        self._body, self._wrists = body, skeleton.sides("Wrist")
        self._along = body.directions[self._wrists]
        beyond = skeleton.descendants(self._wrists[0])
        stems = [skeleton.joints[j].removesuffix("Left") for j in beyond]
        self._fingers = [skeleton.sides(stem) for stem in stems if stem != "Thumb"]
        self._thumbs = skeleton.sides("Thumb") if "Thumb" in stems else None
        self._reach = np.cumsum(body.lengths[self._fingers], axis=0)

    def aims(
        self, positions: Array, rotations: Array, weights: Array
    ) -> tuple[Array, Array]:
        """Return where hands point, and how reliably, in [0, 1] for weights up to 1.

        Args:
            positions: Joint positions [m], shape (..., J, 3).
            rotations: World rotations of the segments, wxyz, shape (..., J, 4).
            weights: Weight of each joint, above 0, shape (..., J).

        Returns:
            Least-squares directions in the frames of the forearms, (..., 2, 3), shorter
            than 1 as far as the joints disagree, and their weights, (..., 2), less for
            hands that bend far, most of which the tracker has lost.
        """
        wrists = positions[..., self._wrists, :]
        pull, total = np.zeros_like(wrists), np.zeros(wrists.shape[:-1])
        for joints, reach in zip(self._fingers, self._reach, strict=True):
            weight = weights[..., joints] * reach
            pull += weight[..., None] * (positions[..., joints, :] - wrists)
            total += weight * reach
        aims = rotate(inverse(rotations[..., self._wrists, :]), pull / total[..., None])
        odd = np.sum((aims - self._along) ** 2, axis=-1) / _ODD**2
        return aims, total / np.sum(self._reach**2, axis=0) / (1.0 + odd)

    def straightened(self, aims: Array, weights: Array) -> Array:
        """Return unit directions of hands (..., 2, 3) that resist bending.

        Arguments are results of ``aims``. No hand bends by 55 degrees or more.
        """
        mixed = unit(weights[..., None] * aims + _STRAIGHT * self._along)
        bend = np.arccos(np.clip(np.vecdot(mixed, self._along), -1.0, 1.0))
        away = unit(mixed - np.cos(bend)[..., None] * self._along)
        less = _softened(bend, *_BEND)[..., None]
        return np.asarray(np.cos(less) * self._along + np.sin(less) * away)

    def thumbs(
        self, positions: Array, rotations: Array, weights: Array, hands: Array
    ) -> tuple[Array, Array]:
        """Return where thumbs are around the forearms, and their weights (..., 2).

        ``hands`` are the directions from ``straightened``; other arguments are as in
        ``aims``. Thumbs (..., 2, 2) are vectors from wrist to thumb across the forearm,
        after the wrist's bend is undone: toward the thumb's place at rest and at right
        angles to that, of length 1 at rest.
        """
        bones = positions[..., self._thumbs, :] - positions[..., self._wrists, :]
        local = rotate(inverse(rotations[..., self._wrists, :]), bones)
        local = rotate(between(hands, self._along), local)
        rest = self._body.directions[self._thumbs]
        ahead = unit(rest - np.vecdot(rest, self._along)[:, None] * self._along)
        across = np.cross(self._along, ahead)
        seen = np.stack([np.vecdot(local, ahead), np.vecdot(local, across)], axis=-1)
        off_axis = np.vecdot(self._body.rest_offsets[self._thumbs], ahead)
        return seen / off_axis[:, None], weights[..., self._thumbs]

    @property
    def has_thumbs(self) -> bool:
        """Whether the skeleton has thumbs, which show the twist of forearms."""
        return self._thumbs is not None

    def twist(self, thumbs: Array, weights: Array) -> Array:
        """Return the twist [rad] of forearms from results of ``thumbs``, (..., 2).

        It is within 80 degrees: of a thumb on the far side, only the part across
        counts, as then the tracker has mostly lost it.
        """
        toward, across = np.moveaxis(weights[..., None] * thumbs, -1, 0)
        angle = np.arctan2(across, np.abs(toward + _UNTWISTED))
        return np.asarray(np.sign(angle) * _softened(np.abs(angle), *_TWIST))

    def posed(
        self, positions: Array, rotations: Array, hands: Array, twist: Array
    ) -> tuple[Array, Array]:
        """Return positions and rotations with forearms twisted and hands placed.

        ``hands`` (..., 2, 3) are unit directions in the frames of the forearms before
        these are twisted [rad] (..., 2). Fingers and thumbs are as at rest.
        """
        positions, rotations = positions.copy(), rotations.copy()
        forearms = rotations[..., self._wrists, :]
        # Forearms of the T-pose point along x, to the left or to the right.
        twisted = multiply(forearms, about_x(twist * self._along[:, 0]))
        rotations[..., self._wrists, :] = twisted
        along = rotate(forearms, self._along)
        turned = multiply(between(along, rotate(forearms, hands)), twisted)
        rest, parents = self._body.rest_offsets, self._body.skeleton.parents
        beyond = [*self._fingers, *([self._thumbs] if self._thumbs else ())]
        for joints in beyond:
            bones = rotate(turned, rest[joints])
            starts = positions[..., [parents[j] for j in joints], :]
            positions[..., joints, :] = starts + bones
            rotations[..., joints, :] = turned
        return positions, rotations


def _softened(angle: Array, free: float, most: float) -> Array:
    """Return angles [rad] that stay up to ``free`` and never reach ``most``."""
    room = most - free
    less = free + room * np.tanh((angle - free) / room)
    return np.where(angle > free, less, angle)
