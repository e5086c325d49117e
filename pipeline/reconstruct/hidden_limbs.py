"""Fills what the sensor did not see: each limb goes on as it went.

A gap is bridged from both ends in the heading frame, a foot that stood stays where it
stood, and what the take itself shows of the limb's movement is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import between, rotate, unit
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.heading_frame import find_yaw
from kinefilter.retarget.stance import smooth_step

from .continuity import bridge
from .foothold import between_ends, standing_height
from .limbs import limb_of, limbs, with_tips
from .prior import MotionPrior, default_prior
from .recall import SHORTEST, learn
from .windows import Limb, Seen, Stretches, describe

_BREAK = 1.0  # s without a frame: what comes after does not go on from before
PAUSE = 0.2
"""Time without a frame [s] that ends a movement."""
_BELIEVED = 2.0  # s from a gap's nearer end: beyond, the sensor's guess counts more
_LONGEST = 10.0  # s: what is hidden for longer is bridged and nothing else


def fill_hidden(
    time: Array,
    positions: Array,
    hidden: Flags,
    skeleton: Skeleton,
    prior: MotionPrior | None = None,
) -> tuple[Array, Flags]:
    """Return joint positions [m] with the hidden ones filled, and which those are.

    Joints that were never seen stay as they are. So does what the sensor guessed long
    after the joint was last seen and long before it is seen again.

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], sensor frame with y up, shape (T, J, 3).
        hidden: Which of them nobody saw, shape (T, J).
        skeleton: The joints.
        prior: What people mostly do; by default the one that ships.

    Returns:
        Positions, shape (T, J, 3), and which of them were filled, shape (T, J).
    """
    hidden = with_tips(hidden & ~hidden.all(axis=0), skeleton)
    hidden &= ~hidden.all(axis=0)
    if not hidden.any() or len(time) < 2:
        return positions, hidden
    seen = seen_motion(time, np.where(hidden[..., None], np.nan, positions), skeleton)
    for gap, limb in _gaps(seen, hidden):
        _fill_limb(seen, gap, limb, prior or default_prior())
    for joints in limbs(skeleton):
        _between_ends(seen, hidden, joints)
    filled = seen.heading.restore(seen.positions)
    trust = _trust(time, hidden)
    guessed = ~np.isnan(positions[..., 0])
    trust[~guessed] = 1.0
    hidden &= (trust > 0.0) & ~np.isnan(filled[..., 0])
    shares = trust[..., None]
    mixed = np.where(shares < 1.0, shares * filled + (1.0 - shares) * positions, filled)
    return np.where(hidden[..., None], mixed, positions), hidden


def _trust(time: Array, hidden: Flags) -> Array:
    """Return how far a filled joint is believed against the sensor's guess, (T, J)."""
    far = np.zeros(hidden.shape)
    for j in np.flatnonzero(hidden.any(axis=0)):
        seen = time[~hidden[:, j]]
        k = np.searchsorted(seen, time)
        before = time - seen[np.maximum(k - 1, 0)]
        after = seen[np.minimum(k, len(seen) - 1)] - time
        far[:, j] = np.minimum(np.abs(before), np.abs(after))
    return 1.0 - smooth_step((far - _BELIEVED) / _BELIEVED)


def seen_motion(time: Array, positions: Array, skeleton: Skeleton) -> Seen:
    """Return a motion whose gaps, NaN, are bridged segment by segment."""
    rate = 1.0 / nominal_step(time)
    steps = np.concatenate([[0.0], np.diff(time)])
    edges = [0, *np.flatnonzero(steps >= _BREAK).tolist(), len(time)]
    stretches = [slice(a, b) for a, b in pairwise(edges)]
    there = ~np.isnan(positions[..., 0])
    root = positions[:, skeleton.root]
    if there[:, skeleton.root].any():
        root = _bridged(root, there[:, skeleton.root], rate, stretches)
    yaw = find_yaw(positions, there.astype(float), skeleton)
    faced = ~np.isnan(yaw)
    frames = np.arange(len(yaw))
    if faced.any():
        yaw = np.interp(frames, frames[faced], np.unwrap(yaw[faced]))
    else:
        yaw = np.zeros(len(yaw))
    heading = HeadingFrame(root, yaw)
    placed = heading.remove(positions)
    parents = np.array(skeleton.parents)
    bones = placed - placed[:, parents]
    known = there & there[:, parents]
    known[:, skeleton.root] = True
    lengths, directions = np.zeros(len(skeleton)), unit(bones)
    placed[:, skeleton.root] = 0.0
    for j in skeleton.order[1:]:
        if not known[:, j].any():
            directions[:, j], lengths[j] = np.nan, np.nan
            continue
        lengths[j] = np.median(np.linalg.norm(bones[known[:, j], j], axis=1))
        if skeleton.hands[j]:
            # Too short for what it did to show through the noise: it turns with the
            # forearm, bent as it is on average.
            along, seen = directions[:, parents[j]], known[:, j]
            bent = np.mean(directions[seen, j] - along[seen], axis=0)
            directions[~seen, j] = unit(along[~seen] + bent)
        else:
            directions[:, j] = unit(
                _bridged(directions[:, j], known[:, j], rate, stretches)
            )
        follows = placed[:, parents[j]] + lengths[j] * directions[:, j]
        placed[:, j] = np.where(there[:, j, None], placed[:, j], follows)
    ankles = [limb[2] for limb in limbs(skeleton)[1::2]]
    floor = standing_height(heading.restore(placed)[:, ankles, 1][there[:, ankles]])
    joined = steps < max(PAUSE, 1.5 / rate)
    joined[0] = False
    return Seen(
        skeleton,
        rate,
        heading,
        placed,
        directions,
        known,
        joined,
        steps >= _BREAK,
        lengths,
        floor,
    )


def _bridged(
    values: Array, known: Flags, rate: float, stretches: Sequence[slice]
) -> Array:
    """Return values (T, C) bridged within stretches; elsewhere the nearest one."""
    bridged, seen = np.empty_like(values), np.flatnonzero(known)
    for part in stretches:
        if known[part].any():
            bridged[part] = bridge(values[part], known[part], rate)
        else:
            nearest = seen[np.argmin(np.abs(seen - part.start))]
            bridged[part] = values[nearest]
    return bridged


def _gaps(seen: Seen, hidden: Flags) -> Iterator[tuple[slice, Limb]]:
    """Yield the gaps of each limb, and what of it is hidden."""
    for joints in limbs(seen.skeleton):
        for gap in runs(np.any(hidden[:, joints[1:]], axis=1)):
            known = seen.known[gap].mean(axis=0)
            known[np.isnan(seen.lengths)] = np.nan
            limb = limb_of(seen.skeleton, joints, known)
            # At the start of a stretch nothing was seen before, and at its end nothing
            # comes after.
            if limb is not None and gap.start > 0 and not seen.breaks[gap].any():
                yield gap, limb


def _fill_limb(seen: Seen, gap: slice, limb: Limb, prior: MotionPrior) -> None:
    """Fill a gap of a limb in ``seen``."""
    length = gap.stop - gap.start
    ahead = gap.stop < len(seen.positions) and not seen.breaks[gap.stop]
    if length > _LONGEST * seen.rate:
        return
    start, at = np.array([gap.start]), np.arange(length)[None]
    long = length > SHORTEST * seen.rate
    about = prior.describe if long else describe
    found = about(Stretches(seen, limb, start, length, at, ahead))
    directions, features = found.base[0], found.features[0]
    if long:
        recall = learn(seen, limb, length, features, prior, ahead=ahead, gap=gap.start)
        if recall is not None:
            directions = recall(found)[0]
    before = seen.directions[gap].copy()
    for k, j in enumerate(limb.hidden):
        gone = ~seen.known[gap, j]
        seen.directions[gap, j][gone] = directions[gone, k]  # a view of the slice
    _place(seen, gap, limb, before)


def _place(seen: Seen, gap: slice, limb: Limb, before: Array) -> None:
    """Put a limb's joints on their segments; hidden hands turn with their forearms."""
    skeleton, placed = seen.skeleton, seen.positions
    end = limb.hidden[-1]
    tips = skeleton.beyond(end)
    turn = between(before[:, end], seen.directions[gap, end])
    for j in [*limb.hidden, *tips]:
        gone, p = ~seen.known[gap, j], skeleton.parents[j]
        if np.isnan(seen.lengths[j]):
            continue
        if j in tips and limb.leg is None:
            turned = rotate(turn, before[:, j])
            seen.directions[gap, j][gone] = turned[gone]
        there = placed[gap, p] + seen.lengths[j] * seen.directions[gap, j]
        placed[gap, j][gone] = there[gone]


def _between_ends(seen: Seen, hidden: Flags, limb: tuple[int, int, int]) -> None:
    """Put hidden elbows and knees between the ends of their limb that were seen."""
    _, middle, end = limb
    frames = hidden[:, middle] & ~hidden[:, end]
    if frames.any() and np.isfinite(seen.lengths[[middle, end]]).all():
        lengths = (seen.lengths[middle], seen.lengths[end])
        first, inner, last = np.moveaxis(seen.positions[frames][:, limb], 1, 0)
        found, _ = between_ends(first, inner, last, lengths)
        seen.positions[frames, middle] = found
