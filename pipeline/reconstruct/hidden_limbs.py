"""Fills what the sensor did not see: each limb continues its own motion.

A gap is bridged from both ends in the heading frame, a planted foot stays in place, and
what people mostly do and what the take itself shows of the limb's motion are added.
Limbs that were never seen, such as legs behind a desk, have no motion to continue:
networks predict their directions from the posture of the rest of the body.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices, chunks, runs
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import between, rotate, unit
from kinefilter.retarget import HeadingFrame, find_yaw

from .continuity import bridge, middle_joint, planted_height
from .prior import MotionPrior, default_prior, standing_height
from .recall import SHORTEST, learn
from .unseen_root import interpolated_yaw, upright_places
from .unseen_steps import both_legs, step_hidden, step_unseen
from .windows import (
    BridgedMotion,
    Descriptions,
    Limb,
    Stretches,
    describe,
    in_limbs,
    limb_of,
    limbs,
    with_tips,
)

_BREAK = 1.0  # s without a frame, after which the motion does not continue
PAUSE = 0.2  # s without a frame, after which a movement ends
_QUERIES = 12  # frames of a gap for which the take's most similar ones are kept
_SHOWN = 0.3  # s for which a knee or elbow has to be seen in a gap of its limb to count
# m that people go during a gap after which a path between its ends means little; limbs
# then continue from both ends instead, at most to this share.
# Chosen on s02, s03, s04, on CMU's 02, 05, 07, 16 and 32, and on walks of p00 to p08.
_WAY, _CONTINUED = 0.3, 0.9
_AT_ONCE = 3000  # frames of a gap that are filled at once, which bounds the memory
# s: standard deviation of the filter over predicted directions. Chosen on s02, s03, s04
# and a quarter of the other people.
_SMOOTHED = 0.2


def fill_hidden(
    time: Array,
    positions: Array,
    hidden: Flags,
    skeleton: Skeleton,
    prior: MotionPrior | None = None,
) -> tuple[Array, Flags]:
    """Return positions [m] with the hidden joints filled, and flags of filled joints.

    Joints that were never seen stay as they are. Time stamps [s] increase strictly;
    positions are in the sensor frame with y up, shape (T, J, 3).
    """
    hidden = with_tips(hidden & ~hidden.all(axis=0), skeleton)
    hidden &= ~hidden.all(axis=0)
    if not hidden.any() or len(time) < 2:
        return positions, hidden
    visible = np.where(hidden[..., None], np.nan, positions)
    if np.isnan(visible[:, skeleton.root]).all():  # nothing shows where the person is
        return positions, np.zeros_like(hidden)
    seen = bridged_motion(time, visible, skeleton)
    # Where elbows are hidden and wrists are not, that shows the arm.
    shown = _place_elbows(seen, hidden)
    gone = hidden & ~shown
    if shown.any():
        placed = seen.heading.restore(seen.positions)
        seen = bridged_motion(time, np.where(gone[..., None], np.nan, placed), skeleton)
    prior = prior or default_prior()
    for gap, limb, frames in _gaps(seen, gone):
        _fill_limb(seen, gap, limb, frames, prior)
    # A limb that is not seen until later comes from where it is seen first.
    backward = seen.backward()
    for gap, limb, frames in _gaps(backward, gone[::-1], last=True):
        _fill_limb(backward, gap, limb, frames, prior)
    filled = seen.heading.restore(seen.positions)
    hidden &= ~np.isnan(filled[..., 0])
    return np.where(hidden[..., None], filled, positions), hidden


def bridged_motion(time: Array, positions: Array, skeleton: Skeleton) -> BridgedMotion:
    """Return a motion whose gaps, NaN, are bridged segment by segment."""
    rate = 1.0 / nominal_step(time)
    steps = np.concatenate([[0.0], np.diff(time)])
    edges = [0, *np.flatnonzero(steps >= _BREAK).tolist(), len(time)]
    stretches = [slice(a, b) for a, b in pairwise(edges)]
    there = ~np.isnan(positions[..., 0])
    root = positions[:, skeleton.root]
    if there[:, skeleton.root].any():
        root = _bridged(root, there[:, skeleton.root], rate, stretches)
    heading = HeadingFrame(root, interpolated_yaw(positions, skeleton))
    placed, parents = heading.remove(positions), np.array(skeleton.parents)
    bones = placed - placed[:, parents]
    known = there & there[:, parents]
    known[:, skeleton.root] = True
    lengths, directions = np.zeros(len(skeleton)), unit(bones)
    placed[:, skeleton.root] = 0.0
    for j in skeleton.order[1:]:
        seen, parent = known[:, j], parents[j]
        if not seen.any():
            directions[:, j], lengths[j] = np.nan, np.nan
            continue
        lengths[j] = np.median(np.linalg.norm(bones[seen, j], axis=1))
        if skeleton.hands[j]:
            # A hand is too short for its own motion to stand out from the noise: it
            # turns with the forearm, at its mean angle to it.
            along = directions[:, parent]
            bent = np.mean(directions[seen, j] - along[seen], axis=0)
            directions[~seen, j] = unit(along[~seen] + bent)
        else:
            bridged = _bridged(directions[:, j], seen, rate, stretches)
            directions[:, j] = unit(bridged)
        follows = placed[:, parent] + lengths[j] * directions[:, j]
        placed[:, j] = np.where(there[:, j, None], placed[:, j], follows)
    ankles = skeleton.sides("Ankle")
    floor = planted_height(heading.restore(placed)[:, ankles, 1][there[:, ankles]])
    joined, breaks = steps < max(PAUSE, 1.5 / rate), steps >= _BREAK
    joined[0] = False
    arrays = (placed, directions, known, joined, breaks, lengths)
    standing = standing_height(root[:, 1])
    return BridgedMotion(skeleton, rate, heading, *arrays, floor, standing)


def _bridged(values: Array, known: Flags, rate: float, stretches: list[slice]) -> Array:
    """Return values (T, C) bridged in each stretch; without any there, the nearest."""
    bridged, seen = np.empty_like(values), np.flatnonzero(known)
    for part in stretches:
        if known[part].any():
            bridged[part] = bridge(values[part], known[part], rate)
        else:
            bridged[part] = values[seen[np.argmin(np.abs(seen - part.start))]]
    return bridged


def _gaps(
    seen: BridgedMotion, hidden: Flags, *, last: bool = False
) -> Iterator[tuple[slice, Limb, Indices]]:
    """Yield the gaps of limbs, their hidden parts, and the frames to fill.

    At the edge of the view, ankles are lost before knees. As long as the knee is seen,
    it shows where the ankle may be; the knee's own gap begins with what was filled.
    With ``last``, only gaps are yielded that no motion follows.
    """
    least = max(round(_SHOWN * seen.rate), 1)
    for joints in limbs(seen.skeleton):
        for gap in runs(np.any(hidden[:, joints[1:]], axis=1)):
            # Nothing is known before the start of the motion or across a break.
            known_before = gap.start > 0 and not seen.breaks[gap].any()
            if not known_before or (last and _ahead(seen, gap)):
                continue
            frames = np.arange(gap.start, gap.stop)
            both = np.ones(len(frames), dtype=np.bool_)
            for part in runs(seen.known[gap, joints[1]], least):
                both[part] = False
            parts = [(gap, frames[~both])] * (not both.all())
            for part in runs(both):
                begin, end = gap.start + part.start, gap.start + part.stop
                parts.append((slice(begin, end), frames[part]))
            for part, some in parts:
                known = seen.known[some].mean(axis=0)
                known[np.isnan(seen.lengths)] = np.nan
                limb = limb_of(seen.skeleton, joints, known)
                if limb is not None:
                    yield part, limb, some


def _ahead(seen: BridgedMotion, gap: slice) -> bool:
    """Return True if the motion goes on after a gap."""
    return gap.stop < len(seen.positions) and not seen.breaks[gap.stop]


def _fill_limb(
    seen: BridgedMotion, gap: slice, limb: Limb, frames: Indices, prior: MotionPrior
) -> None:
    """Fill frames of a gap of a limb in ``seen``, in place."""
    start, length = np.array([gap.start]), gap.stop - gap.start
    at, ahead = frames - gap.start, _ahead(seen, gap)
    hidden = Stretches(seen, limb, start, length, at[None], ahead)
    directions = _directions(hidden, prior)
    if ahead and length > SHORTEST * seen.rate:
        way = seen.heading.root[gap] - seen.heading.root[gap.start - 1]
        far = np.linalg.norm(way[:, [0, 2]], axis=1).max()
        share = _CONTINUED * (1.0 - np.exp(-((far / _WAY) ** 2)))
        ends = (replace(one, ahead=False) for one in (hidden, hidden.backward()))
        first, last = (_directions(end, prior) for end in ends)
        until = ((at + 0.5) / length)[:, None, None]
        continued = first + until * (last[::-1] - first)
        directions = unit(directions + share * (continued - directions))
    before = seen.directions[frames]
    for k, j in enumerate(limb.hidden):
        gone = ~seen.known[frames, j]
        seen.directions[frames[gone], j] = directions[gone, k]
    _place(seen, frames, limb, before)


def _directions(hidden: Stretches, prior: MotionPrior) -> Array:
    """Return the directions of hidden segments in a single stretch, (M, H, 3)."""
    count, long = hidden.at.size, hidden.length > SHORTEST * hidden.seen.rate

    def described(frames: slice) -> Descriptions:
        some = replace(hidden, at=hidden.at[:, frames])
        return prior.describe(some) if long or not hidden.ahead else describe(some)

    recall = None
    if long:
        some = described(slice(None, None, max(count // _QUERIES, 1))).features[0]
        gap, limb, ahead = int(hidden.starts[0]), hidden.limb, hidden.ahead
        recall = learn(
            hidden.seen, limb, hidden.length, some, prior, ahead=ahead, gap=gap
        )
    found = [described(frames) for frames in chunks(count, _AT_ONCE)]
    return np.concatenate(
        [(recall(part) if recall else part.base)[0] for part in found]
    )


def _place(seen: BridgedMotion, frames: Indices, limb: Limb, before: Array) -> None:
    """Put a limb's joints on their segments; hidden hands turn with their forearms."""
    end = limb.hidden[-1]
    tips = seen.skeleton.descendants(end)
    turn = between(before[:, end], seen.directions[frames, end])
    for j in [*limb.hidden, *tips]:
        gone, parent = ~seen.known[frames, j], seen.skeleton.parents[j]
        if np.isnan(seen.lengths[j]):
            continue
        gaps = frames[gone]
        if j in tips and limb.leg is None:
            seen.directions[gaps, j] = rotate(turn, before[:, j])[gone]
        bone = seen.lengths[j] * seen.directions[gaps, j]
        seen.positions[gaps, j] = seen.positions[gaps, parent] + bone


def _place_elbows(seen: BridgedMotion, hidden: Flags) -> Flags:
    """Put hidden elbows between visible shoulders and wrists; return which, (T, J)."""
    placed = np.zeros_like(hidden)
    for top, middle, end in limbs(seen.skeleton):
        lengths = (seen.lengths[middle], seen.lengths[end])
        # Where a knee is, the prior knows better.
        if top in seen.skeleton.hips or not np.isfinite(lengths).all():
            continue
        placed[:, middle] = frames = hidden[:, middle] & ~hidden[:, end]
        first, inner, last = (seen.positions[frames, j] for j in (top, middle, end))
        seen.positions[frames, middle] = middle_joint(first, inner, last, lengths)[0]
    return placed


def point_unseen(
    bones: Array, unseen: Flags, lower: Array, body: Body, prior: MotionPrior
) -> Flags:
    """Point the segments of ``unseen`` limbs (J,) to where they likely are, in place.

    ``bones`` (..., J, 3) and ``lower`` (...) are as for ``posture_inputs``. Returns the
    segments that now have directions, (J,).
    """
    known, skeleton = bones.copy(), body.skeleton
    known[..., unseen, :] = np.nan
    pointed = np.zeros(len(unseen), dtype=np.bool_)
    for _, *joints in limbs(skeleton):
        hidden = tuple(j for j in joints if unseen[j])
        directions = prior.unseen(skeleton, hidden, known, lower)
        if directions is not None:
            segments = list(hidden)
            bones[..., segments, :] = body.lengths[segments, None] * directions
            pointed[segments] = True
    return pointed


def fill_unseen(
    time: Array, positions: Array, unseen: Flags, body: Body, prior: MotionPrior
) -> tuple[Array, Flags]:
    """Return positions [m] with unseen limbs filled, and flags (J,) of these joints.

    Positions (T, J, 3) are in the sensor frame with y up, time stamps [s] increase
    strictly, and ``unseen`` are the joints that the take never shows, shape (J,).
    """
    skeleton, root = body.skeleton, positions[:, body.skeleton.root]
    if not unseen[in_limbs(skeleton)].any() or np.isnan(root).any():
        return positions, np.zeros_like(unseen)
    placed, heading, pointed = _likely(time, positions, unseen, body, prior)
    if both_legs(pointed, skeleton):
        step_unseen(time, placed, heading, body, prior)
    return np.where(pointed[:, None], heading.restore(placed), positions), pointed


def fill_walking(
    time: Array, positions: Array, hidden: Flags, body: Body, prior: MotionPrior
) -> Array:
    """Return positions [m] in which legs of walkers step while both are hidden.

    They were filled before. Arguments are as for ``fill_unseen``, and ``hidden`` says
    which joints were filled, (T, J).
    """
    skeleton = body.skeleton
    legs = np.isin(skeleton.kinds, ("Knee", "Ankle"))
    filled = np.isfinite(positions[:, legs]).all(axis=(1, 2))
    gone = np.asarray(hidden[:, legs].all(axis=1) & filled)
    if not gone.any() or gone.all() or np.isnan(positions[:, skeleton.root]).any():
        return positions
    placed, heading, pointed = _likely(time, positions, legs, body, prior)
    if not both_legs(pointed, skeleton):
        return positions
    return step_hidden(time, positions, placed, heading, gone, body, prior)


def _likely(
    time: Array, positions: Array, unseen: Flags, body: Body, prior: MotionPrior
) -> tuple[Array, HeadingFrame, Flags]:
    """Return joints [m] where unseen limbs likely are, and flags of these joints, (J,).

    The joints (T, J, 3) are in the heading frame, which is returned in between.
    """
    skeleton, root = body.skeleton, positions[:, body.skeleton.root]
    heading = HeadingFrame(root, np.nan_to_num(find_yaw(positions, skeleton)))
    placed = heading.remove(positions)
    hips = np.isin(np.arange(len(skeleton)), skeleton.hips) & unseen
    placed[:, hips] = upright_places(body)[hips]
    bones = placed - placed[:, skeleton.parents]
    lower = root[:, 1] - standing_height(root[:, 1])
    pointed = hips | point_unseen(bones, unseen, lower, body, prior)
    spread = _SMOOTHED / nominal_step(time)
    segments = pointed & ~hips
    smoothed = gaussian_filter1d(bones[:, segments], spread, axis=0, mode="nearest")
    bones[:, segments] = body.lengths[segments, None] * unit(smoothed)
    for j in skeleton.order:
        if segments[j]:
            placed[:, j] = placed[:, skeleton.parents[j]] + bones[:, j]
    return placed, heading, pointed
