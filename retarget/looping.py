"""Looping clips: the end blends into the beginning and planted feet stay in place."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Clip, InputError, Motion, positions_from_rotations
from kinefilter.characters.arrays import Array, Flags, Indices, runs
from kinefilter.characters.rotations import (
    about_y,
    between,
    inverse,
    multiply,
    rotate,
    rotation_vector,
    unit,
)

from .limbs import bent_limb, rejection, shortage, smooth_step
from .standardize import floor_frame

_BLEND = 0.4  # s at the end that are changed, at most half of the clip. A guess.
_MARGIN = 3.0  # s on both sides of a loop; few steps take longer
_FEWEST = 4  # frames of a loop
_FIRM = 1e6  # weight of a foot that never steps, relative to another planted foot
_HINGE = 0.01  # m by which knees count as farther forward, so that straight legs bend
_DEEPEST = 0.1  # of a leg's length: how far the hips sink to let the feet reach
_MOVED = 1e-7  # m: a leg whose foot moves by less stays as it is
_LEFT, _AHEAD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


class _Repetition(NamedTuple):
    """Transform of a clip to its next repetition."""

    turn: Array  # rotation about y, wxyz, (4,)
    here: Array  # point on the floor [m], (3,)
    there: Array  # the same point in the repetition [m], (3,)

    def of(self, points: Array) -> Array:
        return np.asarray(self.there + rotate(self.turn, points - self.here))


def looped(clip: Clip) -> Clip:
    """Return a clip whose last frame matches its first in posture and velocity.

    The person may be in another place by then, with another heading. The next
    repetition begins where feet that are planted in both frames require it, or else at
    the hips. In the last 0.4 s, a growing share of what is missing at the end is added
    to root and rotations (inertialization, Bollo, GDC 2018: a quintic that begins at
    rest and ends with the missing velocity). Legs bend to keep planted feet in place;
    the last step of a foot ends where the next repetition has it. Raises an InputError
    for fewer than four frames, and if different feet are planted at both ends.
    """
    _check(clip)
    time, skeleton = clip.time, clip.skeleton
    blend = min(_BLEND, 0.5 * float(time[-1] - time[0]))
    share = np.clip((time - time[-1]) / blend + 1.0, 0.0, 1.0)
    legs = np.transpose([skeleton.sides(p) for p in ("Hip", "Knee", "Ankle", "Foot")])
    ends = legs[:, 2:].ravel()  # in the order of CONTACTS
    again = _repetition(clip, ends)
    root, rotations = _blended(clip, again, share, blend)
    posed = positions_from_rotations(rotations, root, clip.body)
    goals, contacts = _goals(clip, again, posed[:, ends], ends, share)
    goals = np.swapaxes(goals.reshape(-1, 2, 2, 3), 0, 1)
    sinking = np.zeros(len(clip))
    for leg, goal, heel in zip(legs, goals, contacts.T[::2], strict=True):
        lengths = clip.body.lengths[leg]
        moved = (np.abs(goal - posed[:, leg[2:]]) > _MOVED).any(axis=(1, 2))
        # A raised heel stays a foot's length from the planted toes.
        raised = goal[:, 1] + lengths[3] * unit(goal[:, 0] - goal[:, 1])
        goal[:, 0] = np.where((moved & ~heel)[:, None], raised, goal[:, 0])
        reach = float(lengths[1:3].sum())
        hip = posed[:, leg[0]] - goal[:, 0]
        sinking = np.maximum(sinking, moved * shortage(hip, reach, _DEEPEST * reach))
    root[:, 1] -= sinking
    posed[..., 1] -= sinking[:, None]
    for leg, goal in zip(legs, goals, strict=True):
        _bend(rotations, posed, leg, goal, clip.body.lengths[leg[1:3]])
    return replace(clip, root=root, rotations=rotations, contacts=contacts)


def _check(clip: Clip) -> None:
    time = clip.time
    if len(clip) < _FEWEST or time[-1] <= time[0]:
        raise InputError(
            f"{clip.source}: {len(clip)} frames are too few for --loop, expected at "
            f"least {_FEWEST}; choose --begin and --end farther apart"
        )
    planted = np.asarray(clip.contacts.reshape(-1, 2, 2).any(axis=2))
    for foot, side in enumerate(("left", "right")):
        if planted[0, foot] != planted[-1, foot]:
            where = "beginning" if planted[0, foot] else "end"
            same = int(np.flatnonzero((planted == planted[0]).all(axis=1))[-1])
            before = f" {time[-1] - time[same]:.2f} s earlier" * (same >= _FEWEST)
            raise InputError(
                f"{clip.source}: the {side} foot is planted only at the {where} of the "
                f"loop; choose an --end{before} where the same feet are planted"
            )


def repeated(clip: Clip) -> tuple[Clip, slice]:
    """Return a loop with 3 s of its repetitions on both sides, and its own frames.

    The result has no provenance. In it, feet can be held across the loop's ends.
    """
    time, root, rotations = clip.time, clip.root, clip.rotations
    count, lasts = len(clip), time[-1] - time[0]
    first = int(np.searchsorted(time, time[-1] - _MARGIN))
    stop = int(np.searchsorted(time, time[0] + _MARGIN, "right"))
    frames = np.r_[first : count - 1, :count, 1:stop]
    own = slice(count - 1 - first, 2 * count - 1 - first)
    time, root, rotations = time[frames], root[frames], rotations[frames]
    pelvis = clip.rotations[:, clip.skeleton.root]
    ahead = multiply(pelvis[-1], inverse(pelvis[0]))
    ends = clip.root[0], clip.root[-1]
    for part, turn, (here, there), later in (
        (slice(own.start), inverse(ahead), ends[::-1], -lasts),
        (slice(own.stop, None), ahead, ends, lasts),
    ):
        time[part] += later
        root[part] = there + rotate(turn, root[part] - here)
        rotations[part] = multiply(turn, rotations[part])
    motion = Motion(
        time=time, body=clip.body, root=root, rotations=rotations, source=clip.source
    )
    return Clip.of(motion, contacts=clip.contacts[frames]), own


def _goals(
    clip: Clip, again: _Repetition, posed: Array, ends: Indices, share: Array
) -> tuple[Array, Flags]:
    """Return the goals of heels and toes [m] (T, 4, 3), and their contacts (T, 4).

    The blend alone puts them at ``posed``.
    """
    time, contacts, goals = clip.time, clip.contacts.copy(), posed.copy()
    drift = (time - time[0]) / (time[-1] - time[0])
    for foot in (slice(0, 2), slice(2, 4)):
        paths, planted = clip.positions[:, ends[foot]].copy(), contacts[:, foot]
        both = planted[0] & planted[-1]
        if both.any():
            last = runs(np.asarray(planted.any(axis=1)))[-1]
            # A foot that never steps may still drift; that is undone gradually.
            done = np.ones(len(clip)) if last.start > 0 else drift
            missing = again.of(paths[0]) - paths[-1]
            missing[~both] = missing[both].mean(axis=0)
            paths[last] += done[last, None, None] * missing
        # A heel or toes that are planted only at the end leave the floor.
        planted &= (share <= 0.0)[:, None] | planted[0] | ~planted[-1]
        moves = paths - posed[:, foot]
        joined = [_joined(time, moves[:, k], planted[:, k]) for k in range(2)]
        goals[:, foot] += np.stack(joined, axis=1)
    contacts[-1] = contacts[0]
    return goals, contacts


def _repetition(clip: Clip, ends: Indices) -> _Repetition:
    first, last = clip.positions[0], clip.positions[-1]
    frame = floor_frame(clip.root, clip.rotations[:, clip.skeleton.root], _LEFT)
    yaw = frame.yaw[-1] - frame.yaw[0]
    points, weights = np.array([clip.skeleton.root]), np.ones(1)
    both = np.asarray(clip.contacts[0] & clip.contacts[-1])
    firm = np.asarray(clip.contacts.all(axis=0))
    if both.any():
        points, weights = ends[both], np.where(firm[both], _FIRM, 1.0)
    here, there = (
        np.average(place[points], axis=0, weights=weights) * [1.0, 0.0, 1.0]
        for place in (first, last)
    )
    if firm.sum() > 1:
        # Seen from above, points are complex numbers, and a change of yaw a factor.
        begun, ended = (
            (place[points, 2] - mean[2]) + 1j * (place[points, 0] - mean[0])
            for place, mean in ((first, here), (last, there))
        )
        yaw = np.angle(np.sum(weights * np.conj(begun) * ended))
    return _Repetition(about_y(yaw), here, there)


def _blended(
    clip: Clip, again: _Repetition, share: Array, blend: float
) -> tuple[Array, Array]:
    """Return root and rotations that end as the repetition begins, feet ignored."""
    time, root, rotations = clip.time, clip.root, clip.rotations
    second = int(np.searchsorted(time, time[0], "right"))
    before = int(np.searchsorted(time, time[-1])) - 1
    steps = time[second] - time[0], time[-1] - time[before]
    missing = again.of(root[0]) - root[-1]
    faster = rotate(again.turn, root[second] - root[0]) / steps[0]
    faster -= (root[-1] - root[before]) / steps[1]
    moved = root + _spread(missing, faster * blend, share)
    goal = multiply(again.turn, rotations[0])
    missing = rotation_vector(multiply(goal, inverse(rotations[-1])))
    begun, ended = (
        rotation_vector(multiply(rotations[k], inverse(rotations[k - 1]))) / step
        for k, step in zip((second, -1), steps, strict=True)
    )
    faster = rotate(again.turn, begun) - ended
    changed = share > 0.0
    turned = rotations.copy()
    turns = _turns(_spread(missing, faster * blend, share[changed]))
    turned[changed] = multiply(turns, rotations[changed])
    return moved, turned


def _spread(missing: Array, faster: Array, share: Array) -> Array:
    """Return the change (T, ..., 3): from 0 at rest at share 0 to ``missing`` at 1.

    The velocity at 1 is ``faster`` [1/share], the acceleration 0.
    """
    s = share.reshape(-1, *[1] * missing.ndim)
    return np.asarray(
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * missing
        + s**3 * (s - 1.0) * (4.0 - 3.0 * s) * faster
    )


def _turns(vectors: Array) -> Array:
    """Return rotations, wxyz, about vectors (..., 3) by their length [rad]."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1, keepdims=True)
    axes = 0.5 * np.sinc(half / np.pi) * vectors
    return np.concatenate([np.cos(half), axes], axis=-1)


def _joined(time: Array, moves: Array, planted: Flags) -> Array:
    """Return moves [m] (T, 3) between contacts, 0 at both ends unless planted there."""
    fixed = planted.copy()
    fixed[[0, -1]] = True
    moves = np.where(planted[:, None], moves, 0.0)
    frames = np.flatnonzero(fixed)
    before = frames[np.cumsum(fixed) - 1]
    after = frames[np.cumsum(fixed) - fixed]
    length = np.where(after > before, time[after] - time[before], 1.0)
    share = smooth_step((time - time[before]) / np.maximum(length, 1e-9))[:, None]
    return np.asarray((1.0 - share) * moves[before] + share * moves[after])


def _bend(
    rotations: Array, posed: Array, leg: Indices, goals: Array, lengths: Array
) -> None:
    """Turn a leg (hip, knee, ankle, toes) in place to its goals [m] (T, 2, 3)."""
    some = np.flatnonzero((np.abs(goals - posed[:, leg[2:]]) > _MOVED).any(axis=(1, 2)))
    _, knee, ankle, toe = leg
    hips, knees, ankles, toes = np.moveaxis(posed[some][:, leg], 1, 0)
    goal, tip = np.moveaxis(goals[some], 1, 0)
    toward = rejection(knees - hips, ankles - hips)
    toward += _HINGE * rotate(rotations[some, knee], _AHEAD)
    bend, end = bent_limb(hips, goal, toward, lengths)
    for segment, old, new in (
        (knee, knees - hips, bend - hips),
        (ankle, ankles - knees, end - bend),
        (toe, toes - ankles, tip - goal),
    ):
        rotations[some, segment] = multiply(between(old, new), rotations[some, segment])
