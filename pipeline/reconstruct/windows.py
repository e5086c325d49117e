"""Limbs, and one over a stretch of time: what is seen meanwhile, where it may go.

The same description serves the gap itself and stretches of the take in which the limb
was seen, from which ``recall`` learns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.rotations import unit
from kinefilter.retarget import HeadingFrame

from .continuity import (
    CONTEXT,
    SPEED_FRAMES,
    bridge_matrix,
    coast,
    held_ankle,
    leg_to_goal,
    planted_likelihood,
)

_MOSTLY_SEEN = 0.5  # share of a gap's frames in which a visible segment is seen
_TIPS = ("Hand", "Foot", "Thumb")
_LIMBS = (("Shoulder", "Elbow", "Wrist"), ("Hip", "Knee", "Ankle"))


@cache
def limbs(skeleton: Skeleton) -> tuple[tuple[int, int, int], ...]:
    """Return shoulder, elbow and wrist, or hip, knee and ankle, of each limb."""
    arms, legs = (zip(*map(skeleton.sides, limb), strict=True) for limb in _LIMBS)
    return tuple(limb for side in zip(arms, legs, strict=True) for limb in side)


@cache
def in_limbs(skeleton: Skeleton) -> Flags:
    """Return True for joints beyond a shoulder or a hip, shape (J,)."""
    inside = np.zeros(len(skeleton), dtype=np.bool_)
    for top, _, _ in limbs(skeleton):
        inside[skeleton.descendants(top)] = True
    return inside


def with_tips(hidden: Flags, skeleton: Skeleton) -> Flags:
    """Return flags (..., J) in which hidden wrists and ankles hide hands and feet.

    A hand without its wrist shows only its own position, not that of the arm.
    """
    return np.asarray(hidden | hidden[..., _ends(skeleton)])


@cache
def _ends(skeleton: Skeleton) -> Indices:
    """Return the wrist or ankle of hand and foot joints, others themselves, (J,)."""
    ends = np.arange(len(skeleton))
    for _, _, end in limbs(skeleton):
        ends[skeleton.descendants(end)] = end
    return ends


def limb_of(
    skeleton: Skeleton, joints: tuple[int, int, int], known: Array
) -> Limb | None:
    """Return the hidden part of a limb, given from the trunk outwards, or None.

    ``known`` (J,) is the share of a gap's frames in which each segment is seen, NaN for
    one that is never seen.
    """
    gone = tuple(j for j in joints[1:] if known[j] < 0.5)
    if not gone:
        return None
    visible = tuple(
        j
        for j in skeleton.segments.tolist()
        if j not in gone
        and known[j] >= _MOSTLY_SEEN
        and not skeleton.joints[j].startswith(_TIPS)
    )
    is_leg = skeleton.joints[joints[0]].startswith("Hip") and joints[2] in gone
    return Limb(gone, visible, joints if is_leg else None)


# Length scale of each feature in the kernel. From experiments on people 1 to 3 of six;
# halving or doubling any one of them changes little.
SEEN_CHANGE = 0.5  # m, change of a visible segment since the limb was last seen
_ROOT_CHANGE = 2.2  # m, of the root
SEEN_SPEED = 8.0  # m/s, of a visible segment
SEEN = 1.5  # m, the visible segment itself
_END = 1.5  # direction of a hidden segment when last (and next) seen
_END_SPEED = 12.0  # 1/s, velocity of that direction
_TIME = 0.5  # s since the limb was last seen, and until it is next seen
_HELD = 1.5  # change of a direction by which the foot is held in place
_PLANTED_TIME = 0.27  # s before and after a gap that show whether a foot is planted


@dataclass(frozen=True)
class Limb:
    """A limb of which some segments are hidden."""

    hidden: tuple[int, ...]  # segments, from the trunk outwards, no hands and feet
    visible: tuple[int, ...]  # segments of the body that are seen meanwhile
    leg: tuple[int, int, int] | None  # hip, knee, ankle of a leg whose ankle is hidden


@dataclass(frozen=True, eq=False)
class BridgedMotion:
    """A motion whose gaps are bridged."""

    skeleton: Skeleton
    rate: float  # frame rate [Hz]
    heading: HeadingFrame  # root position and heading in each frame, shape (T,)
    positions: Array  # joint positions [m] in the heading frame, shape (T, J, 3)
    directions: Array  # of the segments, in the heading frame, shape (T, J, 3)
    known: Flags  # True where both ends of a segment were seen, shape (T, J)
    joined: Flags  # True for frames that follow the one before without a pause, (T,)
    breaks: Flags  # True for the first frame of another take, or after a break, (T,)
    lengths: Array  # of the segments [m], NaN for those never seen, shape (J,)
    floor: float  # height of a planted ankle [m]
    standing: float  # height of the root of the person when standing [m]

    def backward(self) -> BridgedMotion:
        """Return a view of the motion in which time runs backward."""
        return replace(
            self,
            heading=HeadingFrame(self.heading.root[::-1], self.heading.yaw[::-1]),
            positions=self.positions[::-1],
            directions=self.directions[::-1],
            known=self.known[::-1],
            # A frame's flag says how it follows the one before it.
            joined=np.roll(self.joined[::-1], 1),
            breaks=np.roll(self.breaks[::-1], 1),
        )

    def bones(self, frames: Indices) -> Array:
        """Return all segments as vectors [m] in frames (...), shape (..., J, 3)."""
        positions = self.positions[frames]
        return np.asarray(positions - positions.take(self.skeleton.parents, -2))


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of a motion in which a limb is, or is treated as, hidden."""

    seen: BridgedMotion
    limb: Limb
    starts: Indices  # first hidden frame of each stretch, shape (W,)
    length: int  # number of hidden frames in each stretch
    at: Indices  # frames to describe, counted from the stretch's start, shape (W, M)
    ahead: bool  # True if the motion after the stretch is known

    def backward(self) -> Stretches:
        """Return the stretches, as they are where time runs backward."""
        starts = len(self.seen.positions) - self.starts - self.length
        at = self.length - 1 - self.at[:, ::-1]
        return replace(self, seen=self.seen.backward(), starts=starts, at=at)

    @cached_property
    def frames(self) -> Indices:
        """Frames of the motion to describe, shape (W, M)."""
        return self.starts[:, None] + self.at

    @cached_property
    def last(self) -> Indices:
        """Last frame before each stretch, shape (W, 1)."""
        return self.starts[:, None] - 1

    @cached_property
    def after(self) -> Indices:
        """First frame after each stretch, or the motion's last one, shape (W, 1)."""
        end = self.starts[:, None] + self.length
        return np.minimum(end, len(self.seen.positions) - 1)

    @cached_property
    def time(self) -> Array:
        """Times since the limb was seen and until it is next [s], shape (2, W, M)."""
        return np.stack([self.at + 1.0, self.length - self.at + 0.0]) / self.seen.rate

    def between(self, before: Array, later: Array) -> Array:
        """Interpolate values (W, 1, ...) from ``last`` to ``after``, if it is known."""
        share = (self.at + 1.0) / (self.length + 1.0)
        share = share.reshape(*share.shape, *(1,) * (before.ndim - 2))
        return before + share * (later - before) if self.ahead else before

    @cached_property
    def root_change(self) -> Array:
        """The root's way since the limb was seen, less ``between`` [m], (W, M, 3)."""
        root = self.seen.heading.root
        line = self.between(root[self.last], root[self.after])
        return np.asarray(root[self.frames] - line)

    @cached_property
    def motion(self) -> tuple[Array, Array, Array]:
        """Change, likewise, velocity [m/s] and vectors [m] of bones, (W, M, J, 3)."""
        seen, frames = self.seen, self.frames
        now, past = (seen.bones(k) for k in (frames, np.maximum(frames - 1, 0)))
        line = seen.bones(self.last)
        if self.ahead:
            next_ = seen.bones(np.minimum(frames + 1, len(seen.positions) - 1))
            line = self.between(line, seen.bones(self.after))
            velocity = 0.5 * seen.rate * (next_ - past)
        else:
            velocity = seen.rate * (now - past)
        return now - line, velocity, now


@dataclass(frozen=True, eq=False)
class Descriptions:
    """Descriptions of a hidden limb in frames of stretches.

    Directions are those of its hidden segments, shape (W, M, H, 3).
    """

    features: Array
    """Components of vectors, and last the times since the limb was seen and, if known,
    until it is next seen, all in units of their length scales, shape (W, M, F)."""
    base: Array  # directions if it continues its motion
    still: Array  # these without the speed that it had
    truth: Array  # directions in the motion itself


def describe(hidden: Stretches) -> Descriptions:
    """Describe stretches in which a limb is hidden."""
    seen, limb, ahead = hidden.seen, hidden.limb, hidden.ahead
    frames, last, after = hidden.frames, hidden.last, hidden.after
    final = len(seen.positions) - 1

    def pointing(which: Indices) -> Array:
        return _flat(seen.directions[which].take(limb.hidden, -2))

    # Segments may hang, in a few frames, on a joint that was never placed.
    change, velocity, bones = map(np.nan_to_num, visible_motion(hidden, limb.visible))
    unmoved = HeadingFrame(np.zeros(3), seen.heading.yaw[frames])
    root = unmoved.remove(hidden.root_change[..., None, :])[..., 0, :]
    per_second, end = seen.rate / SPEED_FRAMES, pointing(last)
    end_speed = per_second * (end - pointing(np.maximum(last - SPEED_FRAMES, 0)))
    features = [
        *(change / SEEN_CHANGE, root / _ROOT_CHANGE),
        *(velocity / SEEN_SPEED, bones / SEEN),
        *(end / _END, end_speed / _END_SPEED),
    ]
    if ahead:
        context = max(round(CONTEXT * seen.rate), 2)
        near = np.arange(context)
        around = np.concatenate([near - context, near + hidden.length])
        around = np.clip(hidden.starts[:, None] + around, 0, final)
        matrix = bridge_matrix(hidden.length, context, seen.rate)[hidden.at]
        base = np.einsum("wmk,wkc->wmc", matrix, pointing(around))
        begin, later = map(pointing, (after, np.minimum(after + SPEED_FRAMES, final)))
        begin_speed = per_second * (later - begin)
        features += [begin / _END, begin_speed / _END_SPEED]
    else:
        base, begin = coast(end, end_speed, hidden.time[0][..., None]), end
    still = np.broadcast_to(hidden.between(end, begin), base.shape)
    base, still = (unit(d.reshape(*frames.shape, -1, 3)) for d in (base, still))
    if limb.leg is None and ahead:
        kept = _momentum(
            np.stack([np.broadcast_to(end_speed, begin_speed.shape), begin_speed]),
            (hidden.length + 1) / seen.rate,
            *(np.linalg.norm(f, axis=-1) for f in (change, root)),
        )
        base = unit(still + kept[..., None, None] * (base - still))
    if limb.leg is not None:
        held = [_on_foot(hidden, limb.leg, d) for d in (base, still)]
        # A leg whose hip was never seen is nowhere.
        held = [
            np.where(np.isnan(h), d, h)
            for h, d in zip(held, (base, still), strict=True)
        ]
        features.append(_flat(held[0] - base) / _HELD)
        base, still = held
    features += [elapsed[..., None] / _TIME for elapsed in hidden.time[: 1 + ahead]]
    if frames.shape[1] > 1:
        features = [np.broadcast_to(f, (*frames.shape, f.shape[-1])) for f in features]
    truth = seen.directions[frames].take(limb.hidden, -2)
    return Descriptions(np.concatenate(features, axis=2), base, still, truth)


def visible_motion(
    hidden: Stretches, segments: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Return ``Stretches.motion`` of some segments as rows, (W, M, 3 S)."""
    change, velocity, vectors = (_flat(v.take(segments, -2)) for v in hidden.motion)
    return change, velocity, vectors


def _flat(values: Array) -> Array:
    """Return the vectors (..., S, 3) of some frames as rows (..., 3 S)."""
    return values.reshape(*values.shape[:-2], -1)


def _momentum(
    speeds: Array, duration: float, seen_change: Array, root_change: Array
) -> Array:
    """Return how much of its speed at the ends an arm keeps in a gap, shape (W, M).

    A linear rule, fitted to the arms of six people; it reduces the error of keeping all
    the speed by 3 to 5 % on people and movements left out. ``speeds`` (2, W, 1, C) are
    those of the directions [1/s] at both ends, ``duration`` [s] apart.
    """
    turns = duration * np.sqrt(3.0 / speeds.shape[-1]) * speeds
    less, more = np.sort(np.linalg.norm(turns, axis=-1), axis=0)
    # Positive if the limb moves out and back, with opposite velocities at the ends.
    back = -np.sum(turns[0] * turns[1], axis=-1) / np.maximum(less * more, 0.05)
    keeps = (
        0.56
        + 0.53 * np.log(duration)
        + 0.16 * less / np.maximum(more, 0.05)
        + 0.48 * back
        + 0.53 * np.tanh(less + more)
        - 0.67 * np.tanh(3.0 * seen_change)
        - 0.82 * np.tanh(3.0 * root_change)
    )
    return np.asarray(np.clip(keeps, 0.0, 1.3))


def _on_foot(hidden: Stretches, leg: tuple[int, int, int], base: Array) -> Array:
    """Return the leg's directions ``base`` with a planted ankle held in place."""
    seen, (hip, knee, ankle) = hidden.seen, leg
    frames, last, after = hidden.frames, hidden.last, hidden.after
    far = max(round(_PLANTED_TIME * seen.rate), 2)

    def world(which: Indices) -> Array:  # the ankle's position [m]
        which = np.clip(which, 0, len(seen.positions) - 1)
        place = seen.positions[which, ankle][..., None, :]
        return np.asarray(seen.heading.at(which).restore(place)[..., 0, :])

    ends = [last + np.arange(1 - far, 1), after + np.arange(far)][: 1 + hidden.ahead]
    planted = [planted_likelihood(world(e), seen.rate, seen.floor) for e in ends]
    seen_after = world(after) if hidden.ahead else None
    likely = [p[:, None] for p in planted]
    place, firm = held_ankle(world(last), seen_after, likely, hidden.time)
    place = seen.heading.at(frames).remove(place[..., None, :])[..., 0, :]
    thigh, shin = seen.lengths[knee], seen.lengths[ankle]
    hips, knees = seen.positions[frames, hip], seen.positions[frames, knee]
    if knee in hidden.limb.hidden:
        knees = hips + thigh * base[..., 0, :]
    ankles = knees + shin * base[..., -1, :]
    goal = ankles + firm[..., None] * (place - ankles)
    if knee not in hidden.limb.hidden:
        return unit(goal - knees)[..., None, :]
    knees, ankles = leg_to_goal(hips, knees, ankles, goal, (thigh, shin))
    return unit(np.stack([knees - hips, ankles - knees], axis=-2))
