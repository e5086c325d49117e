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
        self._parents = skeleton.parents
        arms = zip(skeleton.sides("Elbow"), skeleton.sides("Wrist"), strict=True)
        self._arms = [
            (elbow, wrist, skeleton.descendants(wrist)) for elbow, wrist in arms
        ]

    def carried(
        self, before: Array, after: Array, confidence: Array, body: Body
    ) -> Array:
        """Return postures (..., J, 3) in which unmeasured hands follow their forearms.

        ``before`` and ``after`` are positions [m] before and after joints were moved;
        ``confidence`` (..., J) in [0, 1] is the share of the measurement in each joint.
        A hand stays in place as far as it and its forearm were measured.
        """
        carried = after.copy()
        for elbow, wrist, hand in self._arms:
            turn = between(
                before[..., wrist, :] - before[..., elbow, :],
                after[..., wrist, :] - after[..., elbow, :],
            )
            forearm = confidence[..., [elbow, wrist]].min(axis=-1)
            for j in hand:
                p = self._parents[j]
                share = np.minimum(confidence[..., j], forearm)[..., None]
                follows = rotate(turn, unit(before[..., j, :] - before[..., p, :]))
                stays = unit(after[..., j, :] - after[..., p, :])
                bone = unit(share * stays + (1.0 - share) * follows)
                carried[..., j, :] = carried[..., p, :] + body.lengths[j] * bone
        return carried

    def straightened(self, positions: Array, share: Array, body: Body) -> Array:
        """Return postures (..., J, 3) with hands turned toward their forearms' axes.

        ``share`` (..., J) in [0, 1] is 1 for straight hands and 0 for no change.
        """
        straight = positions.copy()
        for elbow, wrist, hand in self._arms:
            along = unit(positions[..., wrist, :] - positions[..., elbow, :])
            for j in hand:
                p, part = self._parents[j], share[..., j, None]
                bone = unit(positions[..., j, :] - positions[..., p, :])
                bone = body.lengths[j] * unit(part * along + (1.0 - part) * bone)
                turned = straight[..., p, :] + bone
                straight[..., j, :] = np.where(part > 0.0, turned, positions[..., j, :])
        return straight
