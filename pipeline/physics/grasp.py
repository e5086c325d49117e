"""Hands that reach for a prop, hold it between them, and let it go.

A performer mimes: what they hold has another size and place than the prop of the scene.
Where both hands slow down on either side of a prop, the character's hands go to its own
faces. There each palm is tied to the prop until the performer's hands part or hang, the
prop rests where they put it down, or it pulls harder than hands can.
"""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import cross, unit
from kinefilter.retarget.reach import Reach
from kinefilter.retarget.stance import smooth_step

from .holdable import HANDS, HORIZONTAL, UP, Holdable

# All of these are guesses, tried on scripted performances with a box.
_SEEN = 0.3  # reliability of a hand that is seen well enough to let go
_NEAR, _FAR = 0.2, 0.5  # m from their places: hands go there fully, or not at all
_LOST = 0.8  # m from their places: hands that were about to grasp gave up
_SETTLED = 0.3  # m/s: hands that approach more slowly are about to grasp
_PATIENCE = 1.5  # s in which hands that do not come to touch give up
_AROUND = 0.05  # m beside a prop, on the way down to its faces
_REACHING = 12.0  # rad/s: natural frequency at which hands go to their places
_AHEAD = 0.15  # m in front of the hips: nearer hands hang, and hold nothing
_PARTING = 0.08  # m by which hands part to let go, ...
_DRIFTING = 1.0  # s: ... and not as slowly as this
_CALM = 0.15  # s in which hands that hold follow what is seen of them
_FELT = 30.0  # N of a hand, beyond what it holds, at which hands yield
_FORGETTING = 1.0  # s in which hands return from where they yielded to
_LIFTED = 0.08  # m above where it was grasped: a prop that is put down when it rests
_RISE = 0.4  # m of a lift over which the prop comes to where the performer has theirs
_SINK = 0.03  # m by which hands put a prop down lower than they took it up
_RESTS = 0.25  # m/s: slower hands have put down what they hold
_LEAVING_TIME = 0.3  # s in which hands stay beside what they let go
_STRENGTH = 300.0  # N of each hand
_TEARING_TIME = 0.3  # s for which a stronger pull ends a hold
_FLESH = 0.12  # m: thickness of trunk and thighs in front of the joints


def seen_hands(reliability: Array, skeleton: Skeleton) -> Flags:
    """Return which hands (left, right) the sensor saw well, shape (..., 2).

    ``reliability`` has shape (..., J); where it is NaN, hands count as seen.
    """
    return np.asarray(~(reliability[..., skeleton.sides("Hand")] <= _SEEN))


class Grasp:
    """The hands of a character in a scene with props that have ties (``add_ties``).

    At most one prop is held at a time.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: Body) -> None:
        self._data, skeleton = data, body.skeleton
        self._palms, self._shoulders = (
            skeleton.sides("Hand"),
            skeleton.sides("Shoulder"),
        )
        self._root, self._reach = skeleton.root, Reach(body)
        trunk = (
            skeleton.root,
            skeleton.girdle,
            *skeleton.sides("Knee"),
            *skeleton.hips,
        )
        self._front = [model.site(skeleton.joints[j]).id for j in trunk]
        self._sites = [model.site(name).id for name in HANDS]
        palm = float(body.radii[self._palms[0]])
        props = Holdable.all(model, data, palm)
        self.props = [prop for prop in props if prop.weight < 2.0 * _STRENGTH]
        self.start()

    held: Holdable | None = None
    """What the hands hold."""

    def start(self, *, props_stay: bool = False) -> None:
        """Let go of everything; where props stay, hands do not go after what falls."""
        self._released = self.held if props_stay else None
        self.held = None
        self._sought: Holdable | None = None
        self._waited = self._leaving = 0.0
        self._away, self._rate = np.zeros((2, 3)), np.zeros((2, 3))
        self._before: Array | None = None
        for prop in self.props:
            prop.untie()

    @property
    def weight(self) -> float:
        """Weight of what is held [N]."""
        return 0.0 if self.held is None else self.held.weight

    def target(
        self, positions: Array, rotations: Array, dt: float, seen: Flags | None = None
    ) -> tuple[Array, Array]:
        """Return the target (J, 3) and (J, 4), ``dt`` [s] later, with hands on props.

        Ties or unties the hands by where they are now. ``seen`` says which hands (left,
        right) the sensor sees, by default both: a hidden hand keeps what it holds.
        """
        palms = positions[self._palms]
        velocity = 0.0 * palms if self._before is None else (palms - self._before) / dt
        self._before = palms
        side = self._side(positions)
        ahead = (palms - positions[self._root]) @ side[1]
        wanted = np.zeros((2, 3))
        visible = np.ones(2, dtype=bool) if seen is None else seen
        if self.held is None:
            wanted = self._seek(positions, side, velocity, dt)
            if self._leaving > 0.0:
                wanted = self._leave(palms, dt)
        if self.held is not None:
            if self._lets_go(self.held, palms, velocity, visible, ahead, dt):
                self._beside = self._now
                self._release(self.held)
                self._leaving = _LEAVING_TIME
            else:
                wanted = self._carry(self.held, palms, side, visible, dt) - palms
        self._move(wanted, dt)
        if np.abs(self._away).max() < 1e-4:
            return positions, rotations
        return self._reach(positions, rotations, self._away)

    def _move(self, wanted: Array, dt: float) -> None:
        """Move the hands to where they are wanted, as a critically damped spring."""
        off, decay = self._away - wanted, np.exp(-_REACHING * dt)
        drift = self._rate + _REACHING * off
        self._away = wanted + (off + drift * dt) * decay
        self._rate = (self._rate - _REACHING * drift * dt) * decay

    def _side(self, positions: Array) -> Array:
        """Return directions to the left and ahead of the shoulders, rows (2, 3)."""
        left, right = positions[self._shoulders]
        left = unit((left - right) * HORIZONTAL)
        return np.array([left, cross(left, UP)])

    @property
    def _now(self) -> Array:
        """Positions of the character's hands [m], shape (2, 3)."""
        return from_mujoco(self._data.site_xpos[self._sites])

    def _seek(self, positions: Array, side: Array, velocity: Array, dt: float) -> Array:
        """Return the moves (2, 3) of the hands to a prop; tie them if they touch it."""
        palms, nothing = positions[self._palms], np.zeros((2, 3))
        if self._waited == 0.0:
            self._sought = self._nearest(palms)
        prop = self._sought
        places = None if prop is None else prop.places(palms)
        if prop is None or places is None:
            self._waited = 0.0
            return nothing
        lines = places - palms
        far = float(np.linalg.norm(lines, axis=-1).max())
        ahead = min(
            ((p - positions[self._root]) @ side[1]).mean() for p in (palms, places)
        )
        if ahead < _AHEAD or far > (_LOST if self._waited else _FAR):
            self._waited = 0.0
            return nothing
        closing = np.vecdot(unit(lines), velocity).max()
        share = (_FAR - far) / (_FAR - _NEAR)
        if self._waited > 0.0 or (share > 0.3 and closing < _SETTLED):
            self._waited += dt
            share = 1.0
        if self._waited > _PATIENCE:
            self._release(prop)
            return nothing
        hands = self._now
        if self._waited > 0.0 and prop.touched(hands):
            self._hold(prop, palms, side)
        reached = self._around(prop, places, hands) - palms
        return smooth_step(np.array(np.clip(share, 0.0, 1.0))) * reached

    def _nearest(self, palms: Array) -> Holdable | None:
        """Return the prop nearest to the palms, if they are near it."""
        best, found = _FAR, None
        for prop in self.props:
            places = prop.places(palms)
            far = np.inf
            if places is not None:
                far = float(np.linalg.norm(places - palms, axis=-1).max())
            if prop is self._released:  # until the hands have left it
                self._released = prop if far < _FAR else None
            elif far < best:
                best, found = far, prop
        return found

    @staticmethod
    def _around(prop: Holdable, places: Array, hands: Array) -> Array:
        """Return where hands go first, so that they come from beside and not above."""
        outward = unit(places - places.mean(axis=0))
        above = hands[:, 1] - places[:, 1]
        blocked = (np.vecdot(hands - places, outward) < -0.02) & (above > 0.0)
        first = places + _AROUND * np.clip(above / 0.1, 0.0, 1.0)[:, None] * outward
        first[blocked, 1] = prop.center[1] + prop.extent(UP) + 2.0 * _AROUND
        return np.asarray(first)

    def _hold(self, prop: Holdable, palms: Array, side: Array) -> None:
        hands = self._now
        prop.tie(hands)
        self.held, self._waited, self._torn, self._lifted = prop, 0.0, 0.0, False
        self._width = float(np.linalg.norm(hands[0] - hands[1]))
        self._gap = self._narrowest = float(np.linalg.norm(palms[0] - palms[1]))
        self._turn = side @ unit((hands[0] - hands[1]) * HORIZONTAL)
        self._offset = hands.mean(axis=0) - palms.mean(axis=0)
        self._grasped_at, self._rested_at = palms[:, 1].mean(), prop.center[1]
        self._shift, self._clear, self._yield = np.zeros(3), 0.0, np.zeros((2, 3))
        self._carried = hands

    def drop(self) -> None:
        """Let go of what is held, if anything."""
        if self.held is not None:
            self._release(self.held)

    def _release(self, prop: Holdable) -> None:
        prop.untie()
        self.held, self._released, self._waited = None, prop, 0.0

    def _leave(self, palms: Array, dt: float) -> Array:
        """Return the moves (2, 3) of hands that first go aside from what they put down.

        From there they go to where the performer's are.
        """
        self._leaving -= dt
        outward = unit(self._beside - self._beside.mean(axis=0))
        return np.asarray(self._beside + _AROUND * outward - palms)

    def _lets_go(
        self,
        prop: Holdable,
        palms: Array,
        velocity: Array,
        seen: Flags,
        ahead: Array,
        dt: float,
    ) -> bool:
        """Return True if the performer lets go of a prop, or it is torn away."""
        opens = False
        if seen.all():
            gap = float(np.linalg.norm(palms[0] - palms[1]))
            self._gap += (gap - self._gap) * min(dt / _CALM, 1.0)
            slowly = self._narrowest + (self._gap - self._narrowest) * dt / _DRIFTING
            self._narrowest = min(slowly, self._gap)
            opens = self._gap > self._narrowest + _PARTING
            opens |= float(ahead.mean()) < _AHEAD
        self._lifted |= prop.center[1] > self._rested_at + _LIFTED
        slow = float(np.linalg.norm(velocity.mean(axis=0))) < _RESTS
        self._torn = self._torn + dt if prop.pulls.max() > _STRENGTH else 0.0
        put_down = self._lifted and slow and prop.rests
        return opens or put_down or self._torn > _TEARING_TIME

    def _carry(
        self, prop: Holdable, palms: Array, side: Array, seen: Flags, dt: float
    ) -> Array:
        """Return where the hands (2, 3) carry what they hold [m]."""
        prop.turn_level()
        follow = min(dt / _CALM, 1.0)
        # Hands feel what they hold resist, on its support or against the body.
        felt = prop.pulls[:, None] / (_FELT + prop.weight)
        resists = np.clip(felt - 1.0, 0.0, 1.0)
        self._yield += resists * (self._now - self._carried) * follow
        self._yield *= 1.0 - (1.0 - resists) * min(dt / _FORGETTING, 1.0)
        shift = np.zeros(3)
        if seen.all():
            turn = side @ unit((palms[0] - palms[1]) * HORIZONTAL)
            self._turn = unit(self._turn + (turn - self._turn) * follow)
        along = self._turn @ side
        if seen.any() and not seen.all():  # where one hand is tells where both are
            sign = -0.5 if seen[0] else 0.5
            seen_palm = palms[0] if seen[0] else palms[1]
            shift = seen_palm + sign * self._narrowest * along - palms.mean(axis=0)
        self._shift += (shift - self._shift) * follow
        middle = palms.mean(axis=0) + self._shift
        risen = smooth_step(np.array((middle[1] - self._grasped_at) / _RISE))
        middle += (self._offset - _SINK * self._lifted * UP) * (1.0 - risen)
        clear = 0.0 if prop.supported else self._clearance(prop, middle, side[1])
        self._clear += (clear - self._clear) * follow
        middle += self._clear * side[1]
        apart = 0.5 * self._width * along
        self._carried = middle + np.array([apart, -apart]) + self._yield
        return self._carried

    def _clearance(self, prop: Holdable, middle: Array, forward: Array) -> float:
        """Return how far ahead the hands must be for a prop to clear the body [m]."""
        center = middle + prop.center - self._now.mean(axis=0)
        joints = from_mujoco(self._data.site_xpos[self._front])
        points = np.concatenate([joints, 0.5 * (joints[2:4] + joints[4:6])])
        beside = np.abs(points[:, 1] - center[1]) < prop.extent(UP) + _FLESH
        ahead = (points[beside] - center) @ forward + prop.extent(forward) + _FLESH
        return max(float(ahead.max(initial=0.0)), 0.0)
