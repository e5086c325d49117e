"""Hands that nobody saw follow their forearms."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, rotate, unit


class Hands:
    """Turns hands as their forearms are turned.

    Who moves an elbow or a wrist turns the forearm. A hand that was measured stays
    where it is; one that was invented would hang bent if it did not turn too.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._parents = np.array(skeleton.parents)
        arms = zip(skeleton.sides("Elbow"), skeleton.sides("Wrist"), strict=True)
        self._arms = [(elbow, wrist, skeleton.beyond(wrist)) for elbow, wrist in arms]

    def carried(
        self, before: Array, after: Array, confidence: Array, body: Body
    ) -> Array:
        """Return postures (..., J, 3), less trusted hands turned as their forearms.

        ``before`` and ``after`` are positions [m] before and after joints were moved;
        ``confidence`` (..., J) in [0, 1] is how far each hand's joint stays in place,
        if its forearm does.
        """
        carried = after.copy()
        for elbow, wrist, hand in self._arms:
            was, now = (p[..., wrist, :] - p[..., elbow, :] for p in (before, after))
            turn = between(was, now)
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
        """Return postures (..., J, 3), hands laid along their forearms.

        ``share`` (..., J) in [0, 1] is how far; where it is 0, they stay as they are.
        """
        straight = positions.copy()
        for elbow, wrist, hand in self._arms:
            along = unit(positions[..., wrist, :] - positions[..., elbow, :])
            for j in hand:
                p, part = self._parents[j], share[..., j, None]
                bone = unit(positions[..., j, :] - positions[..., p, :])
                bone = body.lengths[j] * unit(part * along + (1.0 - part) * bone)
                there = straight[..., p, :] + bone
                straight[..., j, :] = np.where(part > 0.0, there, positions[..., j, :])
        return straight
