"""A ball under one hand, which pushes it to the floor and meets it when it comes back.

The performer's hand feels no ball, but sets the pace: the ball leaves it where a stroke
is fastest, at a speed that brings it back when the hand is up again.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import unit
from kinefilter.retarget.limbs import at_most, smooth_step

from .carry import PerformerHands
from .holdable import HORIZONTAL, UP, Holdable

# All of these are guesses, tried on scripted performances with a basketball.
_STILL = 0.1  # m/s: a hand that goes down more slowly is at the top of a stroke
_DEPTH, _STROKE = 0.03, 0.25  # m and m/s of a hand that makes a stroke, at least
_UNDER = 0.06  # m from its place under the palm, at most, of a ball that is pushed
_FIRMNESS = 25.0  # rad/s: natural frequency at which a hand has a ball there
_FLIGHT, _SHORTEST = 0.5, 0.25  # s until the first ball is to be back, or any
_RESTITUTION = 0.75  # of a ball that has not bounced yet
_FASTEST = 6.0  # m/s: wrist and fingers push no ball faster
_SPARE = 1.05  # of the energy that takes a ball up to the hand
_CLEAR = 0.01  # m above the floor of a ball that has left it
_MEETING = 0.35  # m above a rising ball, where a hand begins to go to it
_REACH = 0.45  # m that a hand leaves the performer's for a ball
_TOUCH = 0.03  # m from its surface: a hand that has a ball
_STRAY = 0.6  # m beside the hand: a ball that is lost
_PATIENCE = 1.4  # s until a ball is let go that is not pushed, or does not come back
_ROOM, _JOINING = 0.1, 0.3  # m and s of both hands around a ball that they are to have
_FLESH, _GRAZE = 0.1, 0.06  # m from a leg's joints to a ball beside it, less for a push
_CALM, _RETURNING = 0.2, 1.0  # s in which a hand goes aside for a leg, and comes back


class Dribble:
    """Gives a round prop to one ``hand`` of a performer, 0 left or 1 right.

    ``caught`` is where both hands are that have it again [m], (2, 3).
    """

    def __init__(self, prop: Holdable, hand: int, performer: PerformerHands) -> None:
        self.prop, self._hand, self._root = prop, hand, performer.root
        self._restitution, self._pushed = _RESTITUTION, False
        self._rose = self._clock = self._lacked = 0.0
        self._drift = np.zeros(3)
        self.caught: Array | None = None
        self._catch(performer)

    def _catch(self, performer: PerformerHands) -> None:
        self.prop.untie()
        self._has, self._held, self._fastest = True, 0.0, 0.0
        self._thrust: Array | None = None
        self._joins, self._near = False, 0.0
        self._top = performer.palms[self._hand] - performer.root

    def press(self) -> Array | None:
        """Push the ball for the next step of the engine; return the force [N], (3,).

        It is in MuJoCo's world, and None where the hand does not touch the ball.
        """
        if self._has:
            hands = (0, 1) if self._joins else (self._hand,)
            return self.prop.stay_at(hands, _FIRMNESS)
        return None if self._thrust is None else self.prop.push(self._thrust)

    def step(
        self, performer: PerformerHands, hands: Array, front: Array
    ) -> Array | None:
        """Return where the hands (2, 3) go [m]; None if they have the ball no more.

        ``hands`` are where they are now; the ball stays beside ``front`` (N, 3) [m].
        """
        dt, k = performer.dt, self._hand
        self._clock += dt
        if performer.velocity[k, 1] > 0.0:
            self._rose = self._clock
        drift = (performer.root - self._root) / dt * HORIZONTAL
        self._drift += (drift - self._drift) * min(dt / _CALM, 1.0)
        self._root, wanted = performer.root, performer.palms.copy()
        out = performer.side[0] * (1.0 - 2.0 * k)
        lacks = self._lacks(performer.palms[k], out, performer, front)
        slowly = _CALM if lacks > self._lacked else _RETURNING
        self._lacked += (lacks - self._lacked) * min(dt / slowly, 1.0)
        wanted[k] += self._lacked * out
        if not self._has:
            return wanted if self._meets(performer, hands, wanted) else None
        lacks = self._lacks(self.prop.center, out, performer, front)
        free = lacks < _GRAZE and self._is_under(hands)
        return wanted if self._holds(performer, hands, wanted, free=free) else None

    def _lacks(
        self, center: Array, out: Array, performer: PerformerHands, front: Array
    ) -> float:
        """Return how much farther out a ball at a center is to be to miss the legs."""
        off = center - front[front[:, 1] < performer.root[1]]
        free = self.prop.reach + _FLESH
        near = np.abs(off @ performer.side[1]) < free
        return float(np.where(near, free - off @ out, 0.0).max(initial=0.0))

    def _is_under(self, hands: Array) -> bool:
        place = hands[self._hand] - self.prop.reach * UP
        return float(np.linalg.norm(place - self.prop.center)) < _UNDER

    def _holds(
        self, performer: PerformerHands, hands: Array, wanted: Array, *, free: bool
    ) -> bool:
        """Push the ball in a stroke if its way is free; return False if it is let go.

        ``wanted`` (2, 3) is changed to where the hands go [m].
        """
        k, prop, dt = self._hand, self.prop, performer.dt
        self._held += dt
        place, speed = performer.palms[k] - performer.root, performer.velocity[k, 1]
        if speed > -_STILL:
            self._top, self._fastest = place, 0.0
        depth = float(self._top[1] - place[1])
        stroke = depth > _DEPTH and self._fastest < -_STROKE
        if free and stroke and speed > self._fastest:
            aside = wanted[k] - performer.palms[k] + performer.root
            self._push(self._top + aside, depth, dt)
            return True
        self._fastest = min(self._fastest, speed)
        left, right = performer.palms
        around = self._pushed and performer.gap < 2.0 * prop.reach + _ROOM
        around = around and abs(left[1] - right[1]) < _ROOM
        self._near = self._near + dt if around else 0.0
        self._joins = self._near > _JOINING
        if self._joins:
            side = prop.reach * unit(left - right)
            wanted[:] = 0.5 * (left + right) + np.array([side, -side])
            if prop.touched(hands):
                self.caught = hands
                return False
        return self._held < _PATIENCE and not prop.supported

    def _push(self, top: Array, depth: float, dt: float) -> None:
        """Push the ball to the floor, so that it comes back to the top of a stroke."""
        prop = self.prop
        seconds = max(self._rose if self._pushed else _FLIGHT, _SHORTEST)
        low = max(float(prop.center[1] - prop.extent(UP)), 0.0)
        speed = _push_speed(low, low + depth, seconds, self._restitution)
        velocity = (top - prop.center) * HORIZONTAL / seconds + self._drift - speed * UP
        self._thrown = speed**2 + 2.0 * GRAVITY * low
        self._thrust = to_mujoco(velocity - prop.velocity) / dt
        self._has, self._bounced, self._pushed = False, False, True
        self._clock = self._rose = 0.0

    def _meets(self, performer: PerformerHands, hands: Array, wanted: Array) -> bool:
        """Go to a ball that comes back; return False if it is lost.

        ``wanted`` (2, 3) is changed to where the hands go [m].
        """
        prop, k = self.prop, self._hand
        self._thrust = None
        prop.untie()
        center, velocity = prop.center, prop.velocity
        rising, height = float(velocity[1]), float(center[1] - prop.extent(UP))
        if rising > 0.0 and height > _CLEAR and not self._bounced:
            self._bounced = True
            left = rising**2 + 2.0 * GRAVITY * height
            self._restitution = float(np.sqrt(left / self._thrown).clip(0.3, 0.95))
        off = center + prop.reach * UP - wanted[k]
        if self._bounced:
            highest = float(off[1]) + max(rising, 0.0) ** 2 / (2.0 * GRAVITY)
            aside = smooth_step(1.0 + off[1] / _MEETING) * off * HORIZONTAL
            wanted[k] += at_most(_REACH, aside + min(highest, 0.0) * UP)
            away = float(np.linalg.norm(hands[k] - center)) - prop.reach
            closing = float(np.linalg.norm(velocity - performer.velocity[k]))
            if hands[k, 1] > center[1] and away < _TOUCH + closing * performer.dt:
                self._catch(performer)
        stray = float(np.linalg.norm(off * HORIZONTAL)) > _STRAY
        return self._clock < _PATIENCE and not stray


def _push_speed(low: float, high: float, seconds: float, restitution: float) -> float:
    """Return the downward speed [m/s] of a ball that is to bounce up to the hand.

    Its bottom starts at ``low`` [m] and reaches ``high`` after some ``seconds``, or as
    nearly then as it can.
    """
    fall, rise = 2.0 * GRAVITY * low, 2.0 * GRAVITY * high
    slowest = np.sqrt(max(_SPARE * rise / restitution**2 - fall, 0.0))
    speeds = np.linspace(min(slowest, _FASTEST), _FASTEST, 100)
    impact = np.sqrt(speeds**2 + fall)
    after = restitution * impact
    up = after - np.sqrt(np.maximum(after**2 - rise, 0.0))
    duration = (impact - speeds + up) / GRAVITY
    return float(speeds[np.abs(duration - seconds).argmin()])
