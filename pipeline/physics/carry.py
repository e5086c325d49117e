"""A prop between a character's hands, from when they touch it until they let go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import unit
from kinefilter.retarget.limbs import smooth_step

from .holdable import HORIZONTAL, STRENGTH, UP, Holdable

# All of these are guesses, tried on scripted performances with a box.
_AHEAD = 0.15  # m in front of the hips: nearer hands hang, and hold nothing
_PARTING = 0.08  # m by which hands part to let go, ...
_TOGETHER = 0.02  # m by which hands that are about to part have not parted yet
_UNEVEN = 0.9  # of the way of the other hand, so that one may keep a ball, ...
_PATIENCE = 0.8  # s: ... which is to be pushed within this time
_PUSHING = 0.3  # m/s downward of a hand that pushes a ball, ...
_STILL = 4.0  # times faster than the other
_THROWN = 0.8  # m/s upward of hands that throw what they part from
_DRIFTING = 1.0  # s: ... and not as slowly as this
_CALM = 0.15  # s in which hands that hold follow what is seen of them
_FELT = 30.0  # N of a hand, beyond what it holds, at which hands yield
_FORGETTING = 1.0  # s in which hands return from where they yielded to
_LIFTED = 0.08  # m above where it was grasped: a prop that is put down when it rests
_RISE = 0.4  # m of a lift over which the prop comes to where the performer has theirs
_SINK = 0.03  # m by which hands put a prop down lower than they took it up
_RESTS = 0.25  # m/s: slower hands have put down what they hold
_TEARING_TIME = 0.3  # s for which a stronger pull ends a hold
_FLESH = 0.12  # m: thickness of trunk and thighs in front of the joints


@dataclass(frozen=True, eq=False)
class PerformerHands:
    """What the performer's hands do in a frame, left and right; y up."""

    palms: Array  # positions of the hands [m], shape (2, 3)
    velocity: Array  # their velocities [m/s], shape (2, 3)
    seen: Flags  # whether the sensor sees them, shape (2,)
    side: Array  # directions to the left and ahead of the shoulders, rows (2, 3)
    root: Array  # position of the root joint [m], shape (3,)
    dt: float  # time since the last frame [s]

    def behind(self, points: Array) -> bool:
        """Return True if points (N, 3) [m] are not in front of the body."""
        return bool(((points - self.root) @ self.side[1]).mean() < _AHEAD)

    @property
    def gap(self) -> float:
        """Distance between the hands [m]."""
        return float(np.linalg.norm(self.palms[0] - self.palms[1]))

    def turn(self, hands: Array) -> Array:
        """Return the direction from the right hand to the left as in ``side``, (2,)."""
        return np.asarray(self.side @ unit((hands[0] - hands[1]) * HORIZONTAL))


class Carry:
    """Ties a prop to ``hands``, where those of the character are [m], (2, 3).

    ``stays`` is the hand, 0 left or 1 right, that keeps a ball when the hands part.
    """

    def __init__(self, prop: Holdable, hands: Array, performer: PerformerHands) -> None:
        prop.tie(hands)
        self.prop, self._torn, self._lifted = prop, 0.0, False
        self._width = float(np.linalg.norm(hands[0] - hands[1]))
        self._gap = self._narrowest = performer.gap
        self._carried, self._turn = hands, performer.turn(hands)
        middle = performer.palms.mean(axis=0)
        self._offset, self._grasped_at = hands.mean(axis=0) - middle, middle[1]
        self._together = performer.palms - performer.root
        self.stays: int | None = None
        self._apart, self._waits = 0.0, False
        self._rested_at, self._clear = prop.center[1], 0.0
        self._shift, self._yield = np.zeros(3), np.zeros((2, 3))

    def step(
        self, performer: PerformerHands, hands: Array, front: Array
    ) -> Array | None:
        """Return where the hands (2, 3) carry the prop [m]; None if they let it go.

        ``hands`` are where they are now; the prop must not touch ``front`` (N, 3) [m].
        """
        pulls, supported = self.prop.pulls, self.prop.supported
        if self._lets_go(performer, float(pulls.max()), supported):
            return None
        self.prop.turn_level()
        follow = min(performer.dt / _CALM, 1.0)
        # Hands feel what they hold resist, on its support or against the body.
        felt = pulls[:, None] / (_FELT + self.prop.weight)
        resists = np.clip(felt - 1.0, 0.0, 1.0)
        self._yield += resists * (hands - self._carried) * follow
        self._yield *= 1.0 - (1.0 - resists) * min(performer.dt / _FORGETTING, 1.0)
        if performer.seen.all():
            turn = performer.turn(performer.palms)
            self._turn = unit(self._turn + (turn - self._turn) * follow)
        along = self._turn @ performer.side
        middle = self._middle(performer, along, follow)
        risen = smooth_step((middle[1] - self._grasped_at) / _RISE)
        middle += (self._offset - _SINK * self._lifted * UP) * (1.0 - risen)
        ahead = performer.side[1]
        center = middle + self.prop.center - hands.mean(axis=0)
        clear = 0.0 if supported else self._clearance(center, ahead, front)
        self._clear += (clear - self._clear) * follow
        middle += self._clear * ahead
        apart = 0.5 * self._width * along
        self._carried = middle + np.array([apart, -apart]) + self._yield
        return self._carried

    def _lets_go(self, performer: PerformerHands, pull: float, supported: bool) -> bool:
        """Return True if the performer lets go of the prop, or it is torn away."""
        opens, self.stays = False, None
        if performer.seen.all():
            self._gap += (performer.gap - self._gap) * min(performer.dt / _CALM, 1.0)
            wider = (self._gap - self._narrowest) * performer.dt / _DRIFTING
            self._narrowest = min(self._narrowest + wider, self._gap)
            parted = self._gap > self._narrowest + _PARTING
            if self._gap < self._narrowest + _TOGETHER:
                self._together = performer.palms - performer.root
            ball = self.prop.round and not supported
            self.stays = self._pushing(performer) if ball else None
            if parted and self._apart == 0.0:
                self._waits = self._uneven(performer)
            self._apart = self._apart + performer.dt if parted else 0.0
            waits = ball and self._waits and self._apart < _PATIENCE
            opens = (parted and not waits) or performer.behind(performer.palms)
            opens |= self.stays is not None
        self._lifted |= self.prop.center[1] > self._rested_at + _LIFTED
        self._torn = self._torn + performer.dt if pull > STRENGTH else 0.0
        slow = float(np.linalg.norm(performer.velocity.mean(axis=0))) < _RESTS
        put_down = self._lifted and slow and supported and self.prop.rests
        return opens or put_down or self._torn > _TEARING_TIME

    def _pushing(self, performer: PerformerHands) -> int | None:
        """Return which hand pushes a ball down while the other rests, if one does."""
        up = performer.velocity[:, 1]
        apart = self._gap > self._narrowest + _TOGETHER
        pushes = up.min() < min(-_PUSHING, -_STILL * np.abs(up).min())
        return int(up.argmin()) if apart and pushes else None

    def _uneven(self, performer: PerformerHands) -> bool:
        """Return True if hands that part may be about to push a ball with one."""
        moved = performer.palms - performer.root - self._together
        moved = np.linalg.norm(moved, axis=-1)
        thrown = performer.velocity[:, 1].mean() > _THROWN
        return bool(moved.min() < _UNEVEN * moved.max() and not thrown)

    def _middle(self, performer: PerformerHands, along: Array, follow: float) -> Array:
        """Return the point between the performer's hands [m], by those seen, (3,)."""
        between, shift = performer.palms.mean(axis=0), np.zeros(3)
        if performer.seen.any() and not performer.seen.all():
            hand, sign = (0, -0.5) if performer.seen[0] else (1, 0.5)
            shift = performer.palms[hand] + sign * self._narrowest * along - between
        self._shift += (shift - self._shift) * follow
        return np.asarray(between + self._shift)

    def _clearance(self, center: Array, ahead: Array, front: Array) -> float:
        """Return how far ahead a prop at ``center`` must be to clear the body [m]."""
        beside = np.abs(front[:, 1] - center[1]) < self.prop.extent(UP) + _FLESH
        near = (front[beside] - center) @ ahead + self.prop.extent(ahead) + _FLESH
        return float(near.max(initial=0.0))
