"""The stage that aims hands and twists forearms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import Stage
from kinefilter.retarget import Palms

from .floor import clearances, floor_penetration
from .smooth import smooth

_LEAST_WEIGHT = 0.05  # of an unreliable joint; a reliable one has 1
_AIM_CUTOFF, _TWIST_CUTOFF = 1.2, 1.0  # Hz, relative to the forearm
_Filter = Callable[[Array, Array], tuple[Array, Array]]
"""Filters values (..., 2, C) by their weights (..., 2), and filters these too."""


class AimHands(Stage):
    """Stage that turns hands by all of their joints, and forearms by the thumbs.

    Relative to their forearms, hands move slowly and little, so they are smoothed
    there, and more strongly than joints are in the room.
    """

    name = "hands"
    local = True
    in_parts = False  # rotations keep their sign across gaps

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._palms = Palms(body)
        self._aim, self._twist = _Mean(_AIM_CUTOFF), _Mean(_TWIST_CUTOFF)

    def step(self, draft: Draft) -> None:
        """Aim the hands of the next frame."""
        filters = (self._aim.after(draft.elapsed), self._twist.after(draft.elapsed))
        _aim(draft, self._palms, *filters)

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Aim the hands of a take."""
        filters = [_smoothing(draft.time, f) for f in (_AIM_CUTOFF, _TWIST_CUTOFF)]
        _aim(draft, Palms(draft.body), *filters)
        draft.rotations = continuous(draft.rotations)
        draft.posed, there = draft.posed.copy(), draft.positions
        for wrist in draft.skeleton.sides("Wrist"):
            hand = draft.skeleton.descendants(wrist)
            bones = there[:, hand] - there[:, [wrist]]
            draft.posed[:, hand] = draft.posed[:, [wrist]] + bones
        heights = draft.posed[..., 1]
        heights += floor_penetration(heights, clearances(draft.body))[:, None]


class _Mean:
    """A running mean of values by their weights."""

    def __init__(self, cutoff: float) -> None:
        self._rate = 2.0 * np.pi * cutoff  # 1/s
        self._mean: tuple[Array, Array] | None = None

    def after(self, elapsed: float) -> _Filter:
        """Return the filter for a frame that comes so long [s] after the last one."""

        def mean(values: Array, weights: Array) -> tuple[Array, Array]:
            latest = weights[..., None] * values, weights
            old = self._mean or latest
            share = 1.0 - np.exp(-self._rate * elapsed)
            pull, weight = (
                a + share * (b - a) for a, b in zip(old, latest, strict=True)
            )
            self._mean = pull, weight
            return pull / weight[..., None], weight

        return mean


def _smoothing(time: Array, cutoff: float) -> _Filter:
    """Return the zero-lag filter of a take, which does not look across long gaps."""

    def smoothed(values: Array, weights: Array) -> tuple[Array, Array]:
        found, level = np.empty_like(values), np.empty_like(weights)
        for k in parts_of(time):
            found[k] = smooth(time[k], values[k], weights[k], cutoff=cutoff)
            even = np.ones_like(weights[k])
            mean = smooth(time[k], weights[k][..., None], even, cutoff=cutoff)
            level[k] = np.maximum(mean[..., 0], _LEAST_WEIGHT)
        return found, level

    return smoothed


def _aim(draft: Draft, palms: Palms, aim: _Filter, turn: _Filter) -> None:
    """Aim the hands and twist the forearms of a frame or a take."""
    # Pinned joints are far firmer than measured ones.
    firm = np.where(draft.bone_weights > 1.0, draft.bone_weights, 0.0)
    weights = np.maximum(np.maximum(draft.reliability, firm), _LEAST_WEIGHT)
    joints = draft.positions, draft.rotations, weights
    hands = palms.straightened(*aim(*palms.aims(*joints)))
    twist = np.zeros(hands.shape[:-1])
    if palms.has_thumbs:
        twist = palms.twist(*turn(*palms.thumbs(*joints, hands)))
    draft.positions, draft.rotations = palms.posed(*joints[:2], hands, twist)
