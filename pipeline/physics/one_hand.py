"""One hand that takes a prop which is thin enough for it, and puts it down.

It may be a mug, or something on a hinge or a rail: a door, a drawer, a sheet of paper.
A performer who mimes cannot show when the hand closes, so it closes where it comes to
rest at the prop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kinefilter.characters.arrays import Array

from .carry import PerformerHands
from .holdable import STRENGTH, Holdable

# Guesses, tried on a scripted mug and a drawer.
_NEAR = 0.1  # m from its surface: the hand goes to it
_TOUCH = 0.02  # m: the hand has it
_STILL = 0.25  # m/s: slower hands have come to rest, ...
_RESTING = 0.15  # s: ... for this time
_LEFT = 0.2  # m from what it let go of, until the hand may take it again
_JOINING = 1.0  # s in which a hand that holds returns to where the performer's is
_LIFTED = 0.05  # m above where it was taken: a prop that is put down when it rests
_TEARING_TIME = 0.3  # s for which a stronger pull ends a hold


class OneHand:
    """The left (0) or right (1) hand of a character, and what it holds alone."""

    def __init__(self, number: int, props: Sequence[Holdable]) -> None:
        self._number, self._props = number, props
        self.start()

    def start(self) -> None:
        """Let go of everything."""
        self.held: Holdable | None = None
        self._left: Holdable | None = None
        self._rested = self._pulled = 0.0
        self._offset = np.zeros(3)
        self._lifted = False

    def take_over(self, other: OneHand, props: Mapping[str, Holdable]) -> None:
        """Go on as the same hand in another world, which has these props."""
        vars(self).update(vars(other) | {"_props": self._props, "_left": None})
        self.held = other.held and props[other.held.name]

    @property
    def load(self) -> float:
        """Weight of what it holds, if that is free to move [N]."""
        return self.held.weight if self.held is not None and self.held.is_free else 0.0

    def drop(self) -> None:
        """Let go of what is held, if anything."""
        if self.held is not None:
            self.held.untie()
            self.held, self._left, self._rested = None, self.held, 0.0

    def step(self, performer: PerformerHands, hand: Array) -> Array:
        """Return how far from the performer's the hand goes [m], shape (3,).

        ``hand`` is where the character's is [m].
        """
        palm, dt = performer.palms[self._number], performer.dt
        if self.held is not None:
            self._offset *= max(0.0, 1.0 - dt / _JOINING)
            if self._lets_go(self.held, performer):
                self.drop()
            else:
                self.held.turn_level()
            return self._offset
        prop, way = self._nearest()
        far = float(np.linalg.norm(way))
        if prop is None or (prop is self._left and far < _LEFT):
            self._rested = 0.0
            return np.zeros(3)
        self._left = None
        slow = float(np.linalg.norm(performer.velocity[self._number])) < _STILL
        near = far < _NEAR and slow and performer.seen[self._number]
        self._rested = self._rested + dt if near else 0.0
        if self._rested < _RESTING:
            return np.zeros(3)
        if far < _TOUCH:
            prop.tie_one(self._number, hand + way)
            self.held, self._pulled, self._lifted = prop, 0.0, False
            self._offset, self._taken_at = hand - palm, prop.center[1]
            return self._offset
        return np.asarray(hand + way - palm)

    def _nearest(self) -> tuple[Holdable | None, Array]:
        """Return the nearest prop, and the way of the hand's surface to it [m]."""
        best, found, way = np.inf, None, np.full(3, np.inf)
        for prop in self._props:
            line = None if prop.is_tied else prop.way_from(self._number)
            if line is not None and np.linalg.norm(line) < best:
                best, found, way = float(np.linalg.norm(line)), prop, line
        return found, way

    def _lets_go(self, prop: Holdable, performer: PerformerHands) -> bool:
        pull = float(prop.pulls[self._number])
        self._pulled = self._pulled + performer.dt if pull > STRENGTH else 0.0
        self._lifted |= prop.center[1] > self._taken_at + _LIFTED
        slow = float(np.linalg.norm(performer.velocity[self._number])) < _STILL
        put_down = self._lifted and slow and prop.supported and prop.rests
        return put_down or self._pulled > _TEARING_TIME
