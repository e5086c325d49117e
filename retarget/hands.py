"""Hands that follow their forearms where they were not measured."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, between, rotate, unit

_FREE, _MOST = np.radians(40.0), joint_range("HandLeft") - np.radians(1.0)
"""Bend of a wrist [rad] up to which it stays as it is, and which it never reaches: just
inside the humanoid's range. People use 54 to 60 degrees of theirs (Ryu et al. 1991, J.
Hand Surg. 16A); where trackers report more, they have mostly lost the hand."""
_FOLDED = 0.05  # sine of the bend below which a hand that points back has no direction


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

    def bent_less(self, positions: Array) -> Array:
        """Return postures (..., J, 3) in which no wrist bends by 55 degrees or more.

        Hands that bend by more than 40 degrees turn toward their forearms.
        """
        bent, along = positions.copy(), unit(self._forearms(positions))
        wrists = positions[..., self._wrists, :]
        pointing = unit(positions[..., self._joints[0], :] - wrists)
        bend = np.arccos(np.clip(np.vecdot(along, pointing), -1.0, 1.0))
        if not (bend > _FREE).any():
            return bent
        room = _MOST - _FREE
        less = _FREE + room * np.tanh((bend - _FREE) / room)
        sine = np.sin(bend)
        share = np.sin(bend - less)[..., None], np.sin(less)[..., None]
        wanted = share[0] * along + share[1] * pointing
        wanted = np.where((sine < _FOLDED)[..., None], along, wanted)
        turn = between(pointing, wanted)
        turn[bend <= _FREE] = IDENTITY
        for joints in self._joints:
            turned = wrists + rotate(turn, positions[..., joints, :] - wrists)
            much = (bend > _FREE)[..., None]
            bent[..., joints, :] = np.where(much, turned, positions[..., joints, :])
        return bent
