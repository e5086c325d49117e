"""Hands that follow their forearms where they were not measured."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, rotate, unit


class Hands:
    """Rotation of hands with their forearms.

    Moving an elbow or wrist turns the forearm. A measured hand stays in place; a
    reconstructed one turns too, or it would look bent.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._elbows, self._wrists = skeleton.sides("Elbow"), skeleton.sides("Wrist")
        hands = [skeleton.descendants(wrist) for wrist in self._wrists]
        # The joints of both hands at once, those that move others first.
        self._joints = np.transpose(hands)
        self._parents = np.array(skeleton.parents)[self._joints]

    def carried(
        self, before: Array, after: Array, confidence: Array, body: Body
    ) -> Array:
        """Return postures (..., J, 3) in which unmeasured hands follow their forearms.

        ``before`` and ``after`` are positions [m] before and after joints were moved;
        ``confidence`` (..., J) in [0, 1] is the share of the measurement in each joint.
        A hand stays in place as far as it and its forearm were measured.
        """
        carried = after.copy()
        turn = between(self._forearms(before), self._forearms(after))
        forearm = np.minimum(
            confidence[..., self._elbows], confidence[..., self._wrists]
        )
        for joints, parents in zip(self._joints, self._parents, strict=True):
            share = np.minimum(confidence[..., joints], forearm)[..., None]
            bones = before[..., joints, :] - before[..., parents, :]
            follows = rotate(turn, unit(bones))
            stays = unit(after[..., joints, :] - after[..., parents, :])
            bones = unit(share * stays + (1.0 - share) * follows)
            bones *= body.lengths[joints][:, None]
            carried[..., joints, :] = carried[..., parents, :] + bones
        return carried

    def _forearms(self, positions: Array) -> Array:
        """Return the forearms' vectors [m], left and right, shape (..., 2, 3)."""
        return positions[..., self._wrists, :] - positions[..., self._elbows, :]

    def straightened(self, positions: Array, share: Array, body: Body) -> Array:
        """Return postures (..., J, 3) with hands turned toward their forearms' axes.

        ``share`` (..., J) in [0, 1] is 1 for straight hands and 0 for no change.
        """
        straight, along = positions.copy(), unit(self._forearms(positions))
        for joints, parents in zip(self._joints, self._parents, strict=True):
            part = share[..., joints, None]
            bones = unit(positions[..., joints, :] - positions[..., parents, :])
            bones = unit(part * along + (1.0 - part) * bones)
            bones *= body.lengths[joints][:, None]
            turned = straight[..., parents, :] + bones
            straight[..., joints, :] = np.where(
                part > 0.0, turned, positions[..., joints, :]
            )
        return straight
