"""Fills hidden limbs frame by frame, without looking ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import between, rotate, unit
from kinefilter.retarget import HeadingFrame, find_yaw
from kinefilter.retarget.stance import smooth_step

from .foothold import planted_height
from .hidden_limbs import PAUSE, point_unseen
from .limbs import limb_of, limbs, with_tips
from .prior import MotionPrior, default_prior, standing_height
from .recall import Recall, learn
from .windows import BridgedMotion, Limb, Stretches

_MEMORY = 1800  # frames to learn from: a minute at 30 Hz
_LEARNS = 0.1  # s for which a limb is hidden before the recent frames are learned from
_JOINS = 0.2  # s in which a limb that is seen again returns to the measurement
_SETTLES = 0.2  # s: time constant of the directions of a limb that was never seen
_FADES = 0.1  # s in which what was learned fades in
_STRETCH = 1.5  # s: length of the stretches to learn from
_NEW = 0.03  # weight of a frame in the mean angle of a hand: about a second
_RATE = 30.0  # Hz, until the stream shows its own


@dataclass(eq=False)
class _Gap:
    """A limb that is hidden now."""

    limb: Limb
    start: int
    time: float
    floor: float
    standing: float
    recall: Recall | None = None
    learned: float | None = None


class HiddenLimbTracker:
    """Fills the hidden joints of each frame from the frames before.

    A limb continues its motion and comes to rest, a planted foot stays in place, and
    what the last minute shows of the limb's motion is added. Until it is seen first, it
    is where people mostly have it. When the limb is seen again, it returns to the
    measurement within a fifth of a second.
    """

    def __init__(self, body: Body, prior: MotionPrior | None = None) -> None:
        self._prior = prior or default_prior()
        self._body, self._limbs = body, limbs(body.skeleton)
        self._parents = np.array(body.skeleton.parents)
        self._middles_and_ends = [j for _, *joints in self._limbs for j in joints]
        self._hands = [j for j in body.skeleton.order if body.skeleton.hands[j]]
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        rows, n = 2 * _MEMORY, len(self._body.skeleton)
        self._count, self._gaps = 0, dict[int, _Gap]()
        self._times, self._yaw = np.zeros((2, rows))
        self._root = np.zeros((rows, 3))
        self._positions, self._directions = np.zeros((2, rows, n, 3))
        self._known = np.zeros((rows, n), dtype=np.bool_)
        self._joined = np.zeros(rows, dtype=np.bool_)
        self._bent, self._offset = np.zeros((2, n, 3))
        self._since = np.full(n, np.inf)
        self._filled, self._ever = np.zeros((2, n), dtype=np.bool_)

    def step(self, positions: Array, hidden: Flags, time: float) -> tuple[Array, Flags]:
        """Return the next frame's joint positions [m], and flags of filled joints.

        Positions are in the sensor frame with y up, shape (J, 3), and the time stamp
        [s] is later than the last. Hands and feet that were never seen stay as they
        are, and so does the trunk.
        """
        skeleton, k = self._body.skeleton, self._remember(time)
        hidden = with_tips(hidden, skeleton)
        there = ~hidden
        root = positions[skeleton.root]
        yaw = find_yaw(positions, skeleton, there.astype(float))
        if hidden[skeleton.root] or np.isnan(root).any():
            root = self._root[k - 1]
        if np.isnan(yaw):
            yaw = self._yaw[k - 1]
        self._root[k], self._yaw[k] = root, yaw
        heading = HeadingFrame(root, np.asarray(yaw))
        placed = heading.remove(positions)
        known = there & there[self._parents]
        known[skeleton.root] = True
        directions = unit(placed - placed[self._parents])
        last = self._directions[k - 1] if k else self._body.directions
        directions[~known] = last[~known]
        self._ever |= there
        pointed = np.zeros_like(there)
        if not self._ever[self._middles_and_ends].all():
            bones = self._body.lengths[:, None] * directions
            lower = root[1] - standing_height(self._root[: k + 1, 1])
            pointed = point_unseen(bones, ~self._ever, lower, self._body, self._prior)
            if k:
                share = min((time - self._times[k - 1]) / _SETTLES, 1.0)
                likely = unit(bones[pointed])
                bones[pointed] = last[pointed] + share * (likely - last[pointed])
            directions[pointed] = unit(bones[pointed])
        seen = known & skeleton.hands
        bent = directions[seen] - directions[self._parents[seen]]
        self._bent[seen] += _NEW * (bent - self._bent[seen])
        for j in self._hands:
            if not known[j]:
                directions[j] = unit(directions[self._parents[j]] + self._bent[j])
        self._known[k], self._directions[k] = known, directions
        self._positions[k] = self._placed(placed, there, directions)
        for limb, joints in enumerate(self._limbs):
            if (hidden & self._ever)[list(joints[1:])].any() and k:
                self._continue(limb, joints, k)
            else:
                self._gaps.pop(limb, None)
        filled = self._placed(placed, there, self._directions[k])
        self._positions[k] = self._join(filled, hidden, time - self._times[k - 1])
        self._count, placeable = k + 1, self._ever | pointed
        found = heading.restore(self._positions[k])
        return np.where(placeable[:, None], found, positions), hidden & placeable

    def _remember(self, time: float) -> int:
        """Make room for the next frame and return its row."""
        if self._count == 2 * _MEMORY:
            log = (self._times, self._root, self._yaw, self._positions)
            for array in (*log, self._directions, self._known, self._joined):
                array[:_MEMORY] = array[_MEMORY:]
            self._count = _MEMORY
            for gap in self._gaps.values():
                gap.start = max(gap.start - _MEMORY, 1)
        k = self._count
        self._times[k] = time
        self._joined[k] = k == 0 or time - self._times[k - 1] < PAUSE
        return k

    def _placed(self, placed: Array, there: Flags, directions: Array) -> Array:
        """Return a frame with its hidden joints on their segments, (J, 3)."""
        found = placed.copy()
        found[self._body.skeleton.root] = 0.0
        for j in self._body.skeleton.order[1:]:
            if not there[j]:
                bone = self._body.lengths[j] * directions[j]
                found[j] = found[self._parents[j]] + bone
        return found

    def _continue(self, key: int, joints: tuple[int, int, int], k: int) -> None:
        """Continue the motion of a hidden limb in the frame of row k."""
        skeleton, directions = self._body.skeleton, self._directions[k]
        limb = limb_of(skeleton, joints, self._known[k].astype(float))
        if limb is None:
            return
        time, gap = float(self._times[k]), self._gaps.get(key)
        if gap is None or gap.limb != limb:
            since = (k, time) if gap is None else (gap.start, gap.time)
            ankles = skeleton.sides("Ankle")
            heights = self._positions[:k, ankles, 1] + self._root[:k, 1, None]
            standing = standing_height(self._root[: k + 1, 1])
            gap = _Gap(limb, *since, planted_height(heights), standing)
            self._gaps[key] = gap
        seen = self._motion_so_far(k + 1, gap)
        start, at = np.array([gap.start]), np.array([[k - gap.start]])
        stretch = Stretches(seen, limb, start, k - gap.start + 1, at, ahead=False)
        found = self._prior.describe(stretch)
        continued = found.base[0]
        if gap.learned is None and time - gap.time >= _LEARNS:
            frames = round(_STRETCH * seen.rate)
            gap.recall = learn(seen, limb, frames, None, self._prior, ahead=False)
            gap.learned = time
        if gap.recall is not None and gap.learned is not None:
            share = smooth_step((time - gap.learned) / _FADES)
            continued = unit(continued + share * (gap.recall(found)[0] - continued))
        before, end = directions.copy(), limb.hidden[-1]
        directions[list(limb.hidden)] = continued[0]
        if limb.leg is None:
            turn = between(before[end], directions[end])
            for j in skeleton.descendants(end):
                if not self._known[k, j]:
                    directions[j] = rotate(turn, before[j])

    def _motion_so_far(self, count: int, gap: _Gap) -> BridgedMotion:
        steps = np.diff(self._times[max(count - 30, 0) : count])
        rate = 1.0 / float(np.median(steps)) if len(steps) else _RATE
        heading = HeadingFrame(self._root[:count], self._yaw[:count])
        skeleton, lengths = self._body.skeleton, self._body.lengths
        positions, directions = self._positions[:count], self._directions[:count]
        flags = (self._known[:count], self._joined[:count], np.zeros(count, np.bool_))
        arrays = (positions, directions, *flags, lengths)
        return BridgedMotion(skeleton, rate, heading, *arrays, gap.floor, gap.standing)

    def _join(self, filled: Array, hidden: Flags, elapsed: float) -> Array:
        """Return a frame in which limbs that are seen again return smoothly."""
        k, back = self._count, self._filled & ~hidden
        self._offset[back] = self._positions[k - 1][back] - filled[back]
        self._since[back] = 0.0
        self._filled = hidden.copy()
        self._since += elapsed if k else 0.0
        joining = (self._since < _JOINS) & ~hidden
        if joining.any():
            left = 1.0 - smooth_step(self._since[joining] / _JOINS)
            filled[joining] += left[:, None] * self._offset[joining]
        return filled
