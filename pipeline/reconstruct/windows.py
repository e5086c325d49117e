"""A hidden limb over a stretch of time: what is seen meanwhile, and how it goes on.

The same description serves the gap itself and stretches of the take in which the limb
was seen, from which ``recall`` learns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.rotations import unit
from kinefilter.retarget import HeadingFrame

from .continuity import CONTEXT, SPEED_FRAMES, bridge_matrix, coast
from .foothold import bent, hold_place, standing

# Length scale of each feature: how much of it makes postures unlike. From experiments
# on people 1 to 3 of six; halving or doubling any one of them changes little.
SEEN_CHANGE = 0.5  # m, of a visible segment since the limb was last seen
_ROOT_CHANGE = 2.2  # m, of the root
SEEN_SPEED = 8.0  # m/s, of a visible segment
SEEN = 1.5  # m, of a visible segment itself
_END = 1.5  # of a hidden segment's direction when last (and next) seen
_END_SPEED = 12.0  # 1/s, of that direction's velocity
_TIME = 0.5  # s since the limb was last seen, and until it is next seen
_HELD = 1.5  # of what holding the foot in place does to a direction
_STANDING_TIME = 0.27  # s before and after a gap that tell whether a foot stands


@dataclass(frozen=True)
class Limb:
    """A limb of which something is hidden."""

    hidden: tuple[int, ...]
    """Its hidden segments, from the trunk outwards, hands and feet left out."""
    visible: tuple[int, ...]
    """Segments of the body that are seen meanwhile."""
    leg: tuple[int, int, int] | None
    """Hip, knee and ankle, if it is a leg with a hidden ankle."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A motion as far as it is known, gaps bridged; arrays as in a take."""

    skeleton: Skeleton
    """The joints."""
    rate: float
    """Frame rate [Hz]."""
    heading: HeadingFrame
    """Where the root is and where the body faces, shape (T,)."""
    positions: Array
    """Joint positions [m] in the heading frame, shape (T, J, 3)."""
    directions: Array
    """Directions of the segments in the heading frame, shape (T, J, 3)."""
    known: Flags
    """Whether both ends of each segment were seen, shape (T, J)."""
    joined: Flags
    """Whether each frame follows the one before without a pause, shape (T,)."""
    breaks: Flags
    """Whether another take, or the same after a break, begins with a frame, (T,)."""
    lengths: Array
    """Segment lengths [m], shape (J,)."""
    floor: float
    """Height of a standing ankle [m]."""

    def bones(self, segments: tuple[int, ...], frames: Indices) -> Array:
        """Return segments as vectors [m], shape (..., S, 3) for frames (...)."""
        ends = self.positions[frames][..., list(segments), :]
        parents = [self.skeleton.parents[j] for j in segments]
        return np.asarray(ends - self.positions[frames][..., parents, :])


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of a motion in which a limb is, or is taken to be, hidden."""

    seen: Seen
    """The motion."""
    limb: Limb
    """What is hidden of it."""
    starts: Indices
    """First hidden frame of each stretch, shape (W,)."""
    length: int
    """Hidden frames of each stretch."""
    at: Indices
    """Which of its frames are described, from 0 on, shape (W, M)."""
    ahead: bool
    """Whether what comes after the stretch is known."""

    @property
    def frames(self) -> Indices:
        """Frames of the motion that are described, shape (W, M)."""
        return self.starts[:, None] + self.at

    @property
    def last(self) -> Indices:
        """Last frame before each stretch, shape (W, 1)."""
        return self.starts[:, None] - 1

    @property
    def after(self) -> Indices:
        """First frame after each stretch, or the motion's last one, shape (W, 1)."""
        end = self.starts[:, None] + self.length
        return np.minimum(end, len(self.seen.positions) - 1)

    @property
    def time(self) -> Array:
        """Times since the limb was seen, and until it is next [s], shape (2, W, M)."""
        return np.stack([self.at + 1.0, self.length - self.at + 0.0]) / self.seen.rate

    @property
    def share(self) -> Array:
        """Share of the time between both ends that has passed, shape (W, M, 1)."""
        return np.asarray((self.at + 1.0) / (self.length + 1.0))[..., None]

    def between(self, before: Array, later: Array) -> Array:
        """Return values on the straight way between both ends, if the later is known.

        Args:
            before: Values in ``last``, shape (W, 1, C).
            later: Those in ``after``.
        """
        return before + self.share * (later - before) if self.ahead else before


@dataclass(frozen=True, eq=False)
class Windows:
    """A limb in some frames of some stretches of time."""

    features: Array
    """What tells where it goes: components of vectors, and last of all the times since
    it was seen and, if known, until it is seen next, shape (W, M, F)."""
    base: Array
    """Directions of its hidden segments as they would go on, shape (W, M, H, 3)."""
    still: Array
    """Those that they would have without the speed they had, shape (W, M, H, 3)."""
    truth: Array
    """Their directions in the motion, shape (W, M, H, 3)."""


def describe(hidden: Stretches) -> Windows:
    """Describe stretches in which a limb is hidden."""
    seen, limb, ahead = hidden.seen, hidden.limb, hidden.ahead
    frames, last, after = hidden.frames, hidden.last, hidden.after
    end_of_motion = len(seen.positions) - 1

    def pointing(which: Indices) -> Array:
        return _flat(seen.directions[which][..., list(limb.hidden), :])

    rest = visible_motion(hidden, limb.visible)
    roots = seen.heading.root
    moved = roots[frames] - hidden.between(roots[last], roots[after])
    root = HeadingFrame(np.zeros(3), seen.heading.yaw[frames]).remove(
        moved[..., None, :]
    )
    per_second = seen.rate / SPEED_FRAMES
    end = pointing(last)
    end_speed = per_second * (end - pointing(np.maximum(last - SPEED_FRAMES, 0)))
    features = [
        rest[0] / SEEN_CHANGE,
        root[..., 0, :] / _ROOT_CHANGE,
        rest[1] / SEEN_SPEED,
        rest[2] / SEEN,
        end / _END,
        end_speed / _END_SPEED,
    ]
    if ahead:
        context = max(round(CONTEXT * seen.rate), 2)
        around = np.concatenate(
            [np.arange(-context, 0), np.arange(context) + hidden.length]
        )
        around = np.clip(hidden.starts[:, None] + around, 0, end_of_motion)
        matrix = bridge_matrix(hidden.length, context, seen.rate)[hidden.at]
        base = np.einsum("wmk,wkc->wmc", matrix, pointing(around))
        begin = pointing(after)
        later = pointing(np.minimum(after + SPEED_FRAMES, end_of_motion))
        begin_speed = per_second * (later - begin)
        features += [begin / _END, begin_speed / _END_SPEED]
    else:
        base, begin = coast(end, end_speed, hidden.time[0][..., None]), end
    still = np.broadcast_to(hidden.between(end, begin), base.shape)
    base, still = (unit(d.reshape(*frames.shape, -1, 3)) for d in (base, still))
    if limb.leg is None and ahead:
        going = _momentum(
            np.stack([np.broadcast_to(end_speed, begin_speed.shape), begin_speed]),
            (hidden.length + 1) / seen.rate,
            *(np.linalg.norm(f, axis=-1) for f in (rest[0], root[..., 0, :])),
        )
        base = unit(still + going[..., None, None] * (base - still))
    if limb.leg is not None:
        held = [_on_foot(hidden, limb.leg, d) for d in (base, still)]
        features.append((held[0] - base).reshape(*frames.shape, -1) / _HELD)
        base, still = held
    features += [elapsed[..., None] / _TIME for elapsed in hidden.time[: 1 + ahead]]
    wide = [np.broadcast_to(f, (*frames.shape, f.shape[-1])) for f in features]
    truth = seen.directions[frames][..., list(limb.hidden), :]
    return Windows(np.concatenate(wide, axis=2), base, still, truth)


def visible_motion(
    hidden: Stretches, segments: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Return what segments do meanwhile: change [m], velocity [m/s] and bones [m].

    Shapes (W, M, 3 S). The change is that since the limb was last seen, or from the way
    between both ends of the stretch.
    """
    seen, frames, last = hidden.seen, hidden.frames, hidden.last

    def bones(which: Indices) -> Array:
        return _flat(seen.bones(segments, which))

    there, past = bones(frames), bones(np.maximum(frames - 1, 0))
    if not hidden.ahead:
        return there - bones(last), seen.rate * (there - past), there
    following = bones(np.minimum(frames + 1, len(seen.positions) - 1))
    way = hidden.between(bones(last), bones(hidden.after))
    return there - way, 0.5 * seen.rate * (following - past), there


def _flat(values: Array) -> Array:
    """Return the vectors (..., S, 3) of some frames as rows (..., 3 S)."""
    return values.reshape(*values.shape[:-2], -1)


def _momentum(
    speeds: Array, duration: float, seen_change: Array, root_change: Array
) -> Array:
    """Return how much of its speed at the ends an arm keeps in a gap, shape (W, M).

    A linear rule, fitted to the arms of six people. On each of them, and on each of
    ten movements, what the others gave took 3 to 5 % off the error of all the speed.

    Args:
        speeds: Speeds of the directions at both ends [1/s], shape (2, W, 1, C).
        duration: Time between the ends [s].
        seen_change: How far visible segments have moved [m], shape (W, M).
        root_change: How far the root has [m], shape (W, M).
    """
    turns = duration * np.sqrt(3.0 / speeds.shape[-1]) * speeds
    far = np.linalg.norm(turns, axis=-1)
    less, more = np.minimum(*far), np.maximum(*far)
    # Out and back again: the speeds at both ends are against each other.
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
    """Return a leg's directions with its ankle held where it stood, as ``base``."""
    seen, (hip, knee, ankle) = hidden.seen, leg
    frames, last, after = hidden.frames, hidden.last, hidden.after
    count = len(seen.positions)
    far = max(round(_STANDING_TIME * seen.rate), 2)

    def world(which: Indices) -> Array:
        """Return the ankle's place [m] in frames, clipped to the motion."""
        which = np.clip(which, 0, count - 1)
        place = seen.positions[which, ankle][..., None, :]
        return np.asarray(seen.heading.at(which).restore(place)[..., 0, :])

    stood = standing(world(last + np.arange(1 - far, 1)), seen.rate, seen.floor)
    stands = standing(world(after + np.arange(far)), seen.rate, seen.floor)
    place, firm = hold_place(
        world(last),
        world(after) if hidden.ahead else None,
        stood[:, None],
        stands[:, None],
        hidden.time,
    )
    place = seen.heading.at(frames).remove(place[..., None, :])[..., 0, :]
    thigh, shin = seen.lengths[knee], seen.lengths[ankle]
    hips = seen.positions[frames, hip]
    if knee not in hidden.limb.hidden:
        knees = seen.positions[frames, knee]
        ankles = knees + shin * base[..., -1, :]
        return unit(ankles + firm[..., None] * (place - ankles) - knees)[..., None, :]
    knees = hips + thigh * base[..., 0, :]
    ankles = knees + shin * base[..., 1, :]
    goal = ankles + firm[..., None] * (place - ankles)
    knees, ankles = bent(hips, knees, ankles, goal, (thigh, shin))
    return unit(np.stack([knees - hips, ankles - knees], axis=-2))
