"""A ball that flies to a performer's hands, which catch it between them.

The performer holds out both hands, about as far apart as the ball is wide, but sees no
ball. The character's hands go where it will pass, and close on it when it is there.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit
from kinefilter.retarget.limbs import at_most

from .carry import PerformerHands
from .holdable import HORIZONTAL, UP, Holdable

# All of these are guesses, tried on balls thrown at people who hold out their hands.
_COMING = 1.0  # m/s: a ball that flies to the hands at least as fast
_EARLY = 0.6  # s before a ball arrives, in which hands go to meet it
_REACH = 0.45  # m that hands leave the performer's for a ball
_APART = (-0.1, 0.3)  # m that hands are farther apart than a ball that they wait for
_UNEVEN = 0.3  # m by which one hand that waits is higher than the other
_OPEN = 0.04  # m between a ball that comes and each hand
_NEAR = 0.15  # m from between the hands: a ball that they have
_FIRMNESS = 25.0  # rad/s: natural frequency at which they stop it
_PATIENCE = 0.5  # s in which they are on it, or let it go


class Catch:
    """Both hands of a performer, and the ball that comes to them.

    ``caught`` is where the hands are that have it at last [m], (2, 3).
    """

    def __init__(self, prop: Holdable) -> None:
        self.prop = prop
        self._has = self._arrives = False
        self._held = 0.0
        self.caught: Array | None = None

    @classmethod
    def of(cls, props: Iterable[Holdable], performer: PerformerHands) -> Catch | None:
        """Return the catch of a ball that comes to hands which wait for it, or None."""
        left, right = performer.palms
        uneven = abs(left[1] - right[1]) > _UNEVEN
        if uneven or not performer.seen.all() or performer.behind(performer.palms):
            return None
        for prop in props:
            wider = performer.gap - 2.0 * prop.reach
            waits = prop.round and _APART[0] < wider < _APART[1]
            if waits and _meeting(prop, performer) is not None:
                return cls(prop)
        return None

    def press(self) -> Array | None:
        """Stop the ball in the next step of the engine; return the force [N], (3,).

        It is in MuJoCo's world, and None where the hands do not have the ball.
        """
        if self._arrives and not self._has:
            self._has = self.prop.from_palms < _NEAR
        return self.prop.stay_at((0, 1), _FIRMNESS) if self._has else None

    def step(
        self, performer: PerformerHands, hands: Array, _front: Array
    ) -> Array | None:
        """Return where the hands (2, 3) go [m]; None if they have it, or it went by.

        ``hands`` are where they are now.
        """
        prop, dt, middle = self.prop, performer.dt, performer.palms.mean(axis=0)
        side = unit((performer.palms[0] - performer.palms[1]) * HORIZONTAL)
        across = np.array([side, -side])
        if self._has:
            self._held += dt
            self.caught = hands if prop.touched(hands) else None
            if self.caught is not None or self._held > _PATIENCE:
                return None
            place = middle + at_most(_REACH, prop.center - middle)
            return np.asarray(place + prop.reach * across)
        if (meeting := _meeting(prop, performer)) is None:
            return None
        away = prop.center - hands.mean(axis=0)
        ahead = dt * (prop.velocity - performer.velocity.mean(axis=0))
        share = np.clip(-(away @ ahead) / (ahead @ ahead), 0.0, 1.0)
        self._arrives = bool(np.linalg.norm(away + share * ahead) < _NEAR)
        return np.asarray(meeting + (prop.reach + _OPEN) * across)


def _meeting(prop: Holdable, performer: PerformerHands) -> Array | None:
    """Return where a ball in flight comes nearest to the performer's hands [m], (3,).

    None if it does not come near soon.
    """
    middle, velocity = performer.palms.mean(axis=0), prop.velocity
    away = prop.center - middle
    if unit(away) @ velocity > -_COMING or prop.supported:
        return None
    times = np.linspace(0.0, _EARLY, 25)[:, None]
    path = away + velocity * times - 0.5 * GRAVITY * times**2 * UP
    far = np.linalg.norm(path, axis=-1)
    nearest = int(far.argmin())
    if far[nearest] > _REACH or nearest == len(times) - 1:
        return None
    return np.asarray(middle + path[nearest])
