"""Hands that reach for a prop, hold it between them, and let it go.

A performer mimes: what they hold has another size and place than the prop of the scene.
Where both hands slow down on either side of a prop, the character's hands go to its own
faces. There each palm is tied to the prop until the performer's hands part or hang, the
prop rests where they put it down, or it pulls harder than hands can. A ball may go to
one hand that pushes it to the floor, and back, or fly into hands that wait for it. Thin
props are for one hand alone.
"""

from __future__ import annotations

import mujoco
import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.rotations import cross, unit
from kinefilter.retarget.limbs import Reach, smooth_step

from .carry import Carry, PerformerHands
from .catch import Catch
from .compliance import damped
from .dribble import Dribble
from .holdable import HANDS, HORIZONTAL, STRENGTH, UP, Holdable
from .one_hand import OneHand

# All of these are guesses, tried on scripted performances with a box.
_SEEN = 0.3  # reliability of a hand that is seen well enough to let go
_NEAR, _FAR = 0.2, 0.5  # m from their places: hands go there fully, or not at all
_LOST = 0.8  # m from their places: hands that were about to grasp gave up
_SETTLED = 0.3  # m/s: hands that approach more slowly are about to grasp
_LIKELY = 0.3  # share of the way to their places, from which hands may grasp
_PATIENCE = 1.5  # s in which hands that do not come to touch give up
_AROUND = 0.05  # m beside a prop, on the way down to its faces
_INSIDE = 0.02  # m that a hand above a prop is too far inside to come down beside it
_REACHING = 12.0  # rad/s: natural frequency at which hands go to their places
_LEAVING_TIME = 0.3  # s in which hands stay beside what they let go


def seen_hands(reliability: Array, skeleton: Skeleton) -> Flags:
    """Return which hands (left, right) the sensor saw well, shape (..., 2).

    ``reliability`` has shape (..., J); where it is NaN, hands count as seen.
    """
    return np.asarray(~(reliability[..., skeleton.sides("Hand")] <= _SEEN))


class Grasp:
    """The hands of a character in a scene with props that have ties (``add_ties``).

    Both hold one prop, or each one of its own. Names of the character's parts begin
    with ``prefix``.
    """

    def __init__(self, data: mujoco.MjData, body: Body, prefix: str = "") -> None:
        self._data, model, skeleton = data, data.model, body.skeleton
        self._palms = skeleton.sides("Hand")
        self._shoulders = skeleton.sides("Shoulder")
        self._root, self._reach = skeleton.root, Reach(body)
        knees, trunk = skeleton.sides("Knee"), [skeleton.root, skeleton.girdle]
        front = [*trunk, *knees, *skeleton.hips]
        self._front = [model.site(f"{prefix}{skeleton.joints[j]}").id for j in front]
        left, right = (f"{prefix}{hand}" for hand in HANDS)
        self._sites = [model.site(name).id for name in (left, right)]
        palm = float(body.radii[self._palms[0]])
        props = Holdable.all(data, palm, (left, right))
        self.props = [prop for prop in props if prop.weight < 2.0 * STRENGTH]
        self._wide = [prop for prop in self.props if prop.for_two]
        thin = [prop for prop in self.props if prop.for_one]
        self._each = [OneHand(number, thin) for number in (0, 1)] if thin else []
        self._carry: Carry | Catch | Dribble | None = None
        self._sought: Holdable | None = None
        self.start()

    def start(self, *, props_stay: bool = False) -> None:
        """Let go of everything; where props stay, hands do not go after what falls."""
        self._released = self.held if props_stay else None
        self._carry = self._sought = None
        self._waited = self._leaving = 0.0
        self._away, self._rate, self._beside = np.zeros((3, 2, 3))
        self._before: Array | None = None
        for hand in self._each:
            hand.start()
        for prop in self.props:
            prop.untie()

    def take_over(self, other: Grasp) -> None:
        """Hold what one of the same body holds in another world."""
        for name in ("_away", "_rate", "_beside", "_before", "_leaving"):
            setattr(self, name, getattr(other, name))
        mine = {prop.name: prop for prop in self.props}
        for prop in other.props:
            mine[prop.name].take_over(prop)
        if (carry := other._carry) is not None:
            carry.prop = mine[carry.prop.name]
            self._carry = carry
        for hand, before in zip(self._each, other._each, strict=True):
            hand.take_over(before, mine)

    @property
    def held(self) -> Holdable | None:
        """What both hands hold, or else one of them."""
        if self._carry is not None and not isinstance(self._carry, Catch):
            return self._carry.prop
        return next((hand.held for hand in self._each if hand.held), None)

    @property
    def loads(self) -> Array:
        """Weight of what each hand holds [N], shape (2,)."""
        if isinstance(self._carry, Carry):
            return np.full(2, 0.5 * self._carry.prop.weight)
        loads = np.zeros(2)
        for number, hand in enumerate(self._each):
            loads[number] = hand.load
        return loads

    def press(self) -> Array | None:
        """Push a ball that is not tied in the next step of the engine.

        Returns the force [N], (3,), in MuJoCo's world, or None where no hand has it.
        """
        return None if isinstance(self._carry, Carry | None) else self._carry.press()

    def drop(self) -> None:
        """Let go of what is held, if anything."""
        if self._carry is not None:
            self._release(self._carry.prop)
        for hand in self._each:
            hand.drop()

    def target(
        self, positions: Array, rotations: Array, dt: float, seen: Flags | None = None
    ) -> tuple[Array, Array]:
        """Return the target (J, 3) and (J, 4), ``dt`` [s] later, with hands on props.

        Ties or unties the hands by where they are now. ``seen`` says which hands (left,
        right) the sensor sees, by default both: a hidden hand keeps what it holds.
        """
        if not self.props:
            return positions, rotations
        performer = self._performer(positions, seen, dt)
        wanted = np.zeros((2, 3))
        if self.held is None and self._carry is None:
            self._carry = Catch.of(self._wide, performer)
        if self._carry is None:
            wanted = self._seek(performer)
            if self._waited > 0.0:  # the hands stay at the prop, not the performer's
                self._away -= performer.velocity * dt
            if self._leaving > 0.0:  # first aside from what the hands put down
                self._leaving -= dt
                outward = unit(self._beside - self._beside.mean(axis=0))
                wanted = self._beside + _AROUND * outward - performer.palms
        if self._carry is not None:
            sites = from_mujoco(self._data.site_xpos[self._front])
            thighs = 0.5 * (sites[2:4] + sites[4:6])
            front = np.concatenate([sites, thighs])
            carried = self._carry.step(performer, self._now, front)
            if carried is not None:
                wanted = carried - performer.palms
            elif (passed := self._passed_on(performer)) is not None:
                self._carry, wanted = passed, self._away
            elif isinstance(self._carry, Catch):  # the ball went by
                self._carry.prop.untie()
                self._carry = None
            else:
                self.drop()
                self._beside, self._leaving = self._now, _LEAVING_TIME
        for number, hand in enumerate(self._each):
            if self._carry is None and self._waited == 0.0:
                wanted[number] += hand.step(performer, self._now[number])
            else:
                hand.drop()
        off, self._rate = damped(self._away - wanted, self._rate, _REACHING, dt)
        self._away = wanted + off
        if np.abs(self._away).max() < 1e-4:
            return positions, rotations
        return self._reach(positions, rotations, self._away)

    def _passed_on(self, performer: PerformerHands) -> Carry | Dribble | None:
        """Return what happens to a ball that both hands have now, or one of them."""
        carry = self._carry
        if isinstance(carry, Carry) and carry.stays is not None:
            return Dribble(carry.prop, carry.stays, performer)
        if isinstance(carry, Catch | Dribble) and carry.caught is not None:
            return Carry(carry.prop, carry.caught, performer)
        return None

    def _performer(
        self, positions: Array, seen: Flags | None, dt: float
    ) -> PerformerHands:
        palms, shoulders = positions[self._palms], positions[self._shoulders]
        velocity = (palms - (palms if self._before is None else self._before)) / dt
        self._before = palms
        left = unit((shoulders[0] - shoulders[1]) * HORIZONTAL)
        side, root = np.array([left, cross(left, UP)]), positions[self._root]
        seen = np.ones(2, dtype=bool) if seen is None else seen
        return PerformerHands(palms, velocity, seen, side, root, dt)

    @property
    def _now(self) -> Array:
        """Positions of the character's hands [m], shape (2, 3)."""
        return from_mujoco(self._data.site_xpos[self._sites])

    def _seek(self, performer: PerformerHands) -> Array:
        """Return the moves (2, 3) of the hands to a prop; tie them if they touch it."""
        palms, nothing = performer.palms, np.zeros((2, 3))
        waited, self._waited = self._waited, 0.0
        if waited == 0.0:
            self._sought = self._nearest(palms)
        prop = self._sought
        if prop is None or (places := prop.places(palms)) is None:
            return nothing
        lines = places - palms
        far = float(np.linalg.norm(lines, axis=-1).max())
        behind = performer.behind(palms) or performer.behind(places)
        if behind or far > (_LOST if waited else _FAR):
            return nothing
        closing = np.vecdot(unit(lines), performer.velocity).max()
        share = (_FAR - far) / (_FAR - _NEAR)
        if waited > 0.0 or (share > _LIKELY and closing < _SETTLED):
            waited, share = waited + performer.dt, 1.0
        if waited > _PATIENCE:
            self._release(prop)
            return nothing
        hands = self._now
        if waited > 0.0 and prop.touched(hands):
            self._carry = Carry(prop, hands, performer)
        else:
            self._waited = waited
        reached = self._around(prop, places, hands) - palms
        return smooth_step(share) * reached

    def _nearest(self, palms: Array) -> Holdable | None:
        """Return the prop nearest to the palms, if they are near it."""
        best, found = _FAR, None
        for prop in self._wide:
            places, far = prop.places(palms), np.inf
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
        inside = np.vecdot(places - hands, outward) > _INSIDE
        aside = np.clip(above / 0.1, 0.0, 1.0)
        if prop.round:  # would roll away from the hand that comes first
            late = np.linalg.norm(places - hands, axis=-1).max() - _AROUND
            aside = np.maximum(aside, np.clip(late / 0.1, 0.0, 1.0))
        first = places + _AROUND * aside[:, None] * outward
        top = prop.center[1] + prop.extent(UP) + 2.0 * _AROUND
        first[inside & (above > 0.0), 1] = top
        return np.asarray(first)

    def _release(self, prop: Holdable) -> None:
        prop.untie()
        self._carry, self._released, self._waited = None, prop, 0.0
