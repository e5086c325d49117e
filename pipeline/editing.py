"""Cleans a take again near its edits, and leaves the rest of the clip as it was.

Within half a second of an edit, the motions cleaned with and without it blend into each
other; farther away nothing changes. Whatever is measured over the whole take, such as
the body and the floor, is taken from the clip without edits. A pinned joint takes its
neighbors in time and in the body along.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Origin, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.rotations import continuous, normalize
from kinefilter.retarget.limbs import smooth_step

from .draft import Draft, Unedited
from .edits import Edit, distrusted, edited, exchanged, with_contacts
from .progress import Progress
from .reconstruct.continuity import middle_joint
from .reconstruct.windows import limbs
from .stages import Stage
from .target.feet import ankles_and_toes
from .target.planting import PLANTED
from .target.target_stages import Feet

# Distances from the nearest edit [s].
_FULL = 0.15  # within it only the edited target counts
_FADED = 0.4  # beyond it the edited target does not count: physics lags behind
_AROUND = 0.5  # beyond it nothing changes, nor does a pin move its joint
_SETTLED = 0.4  # last part of that, in which physics blends into the previous motion
_CONTEXT = 1.0  # beyond it, frames that smoothing and physics need as a lead-in
_MOVED = 1e-4  # m
_OF_TAKE = ("distrust", "exchange")  # edits that change the take itself
_RAISED = 0.01  # m: a foot that is pinned higher has left the floor. A guess.
_FARTHEST = 2.0  # m from where the joint is; more is hardly meant. A guess


def unedited(stages: Sequence[Stage], take: Take, progress: Progress) -> Unedited:
    """Pass a take through the stages, keeping what cleaning it again needs."""
    draft, after = Draft.of(take), dict[str, Draft]()
    for stage in stages:
        stage.run(draft, progress)
        after[stage.name] = copy(draft)
    return Unedited(after["correct"], after["feet"], draft)


def clean_again(
    stages: Sequence[Stage],
    take: Take,
    edits: Sequence[Edit],
    before: Unedited,
    progress: Progress,
) -> Draft:
    """Return the draft of a take, cleaned again near its edits."""
    names = [stage.name for stage in stages]
    correct, feet = names.index("correct"), names.index("feet")
    away = _away(take, [edit for edit in edits if edit.kind in _OF_TAKE])
    since = take.time - take.time[0]
    if "failures" in names:
        changed = Draft.of(take)
        changed.exchanged = exchanged(edits, since)
        changed.distrusted = distrusted(edits, since, take.skeleton)
    else:
        changed = Draft.of(edited(take, edits, since))
    draft = copy(before.corrected)
    changed.unedited = draft.unedited = before
    changed.failures = before.done.failures
    if np.isfinite(away).any():
        for stage in stages[:correct]:
            stage.run(changed, progress)
        for part, frames in _again([stages[correct]], changed, away, progress):
            draft.put(part, frames, away <= _AROUND)
    for stage in stages[correct + 1 : feet]:
        stage.run(draft, progress)
    # Far from the edits, feet stand as before, even where that was a close decision.
    far = (away > _AROUND)[:, None]
    draft.stands = np.where(far, before.planted.stands, draft.stands)
    away_of_feet = _plant(stages[feet], draft, edits, progress)
    away = np.minimum(_away(take, edits), away_of_feet)
    pin(draft, [edit for edit in edits if edit.kind == "pin"], before)
    share = smooth_step((_FADED - away) / (_FADED - _FULL))[:, None]
    old, planted = before.planted, copy(before.planted)
    planted.put(draft, slice(None), away < 0.5 * (_FULL + _FADED))
    change = draft.bone_weights - old.bone_weights
    planted.bone_weights = old.bone_weights + share * change
    change = draft.positions - old.positions
    planted.positions = old.positions + share[..., None] * change
    done, later = copy(before.done), stages[feet + 1 :]
    for part, frames in _again(later, planted, away, progress):
        if all(stage.local for stage in later):
            _fade(part, before.done.part(frames), away[frames])
            done.put(part, frames, away <= _AROUND)
        else:
            done = part
    done.rotations = continuous(done.rotations)
    near = away <= _AROUND
    done.failures = (
        *(f for f in before.done.failures if not near[f.first : f.last + 1].any()),
        *(f for f in changed.failures if near[f.first : f.last + 1].any()),
    )
    return done


def _again(
    stages: Sequence[Stage], draft: Draft, away: Array, progress: Progress
) -> Iterator[tuple[Draft, slice]]:
    """Run stages near the edits, or on all frames if need be; yield parts, frames."""
    spans = runs(away <= _AROUND + _CONTEXT)
    if not all(stage.local for stage in stages):
        spans = [slice(0, len(draft.time))]
    for frames in spans:
        part = draft.part(frames)
        for stage in stages:
            stage.run(part, progress)
        yield part, frames


def _fade(part: Draft, before: Draft, away: Array) -> None:
    """Blend the ends of a part, which physics has bent, into the previous motion."""
    share = smooth_step((_AROUND - away) / _SETTLED)[:, None, None]
    opposite = np.vecdot(part.rotations, before.rotations)[..., None] < 0.0
    rotations = np.where(opposite, -part.rotations, part.rotations)
    change = rotations - before.rotations
    part.rotations = normalize(before.rotations + share * change)
    for name in ("positions", "posed"):
        old, new = getattr(before, name), getattr(part, name)
        setattr(part, name, old + share * (new - old))


def _plant(
    stage: Stage, draft: Draft, edits: Sequence[Edit], progress: Progress
) -> Array:
    """Plant the feet with the edited contacts.

    Returns the time [s] (T,) from each frame to the nearest stance that this moves.
    """
    loose, since = copy(draft), draft.time - draft.time[0]
    stage.run(draft, progress)
    edits = [edit for edit in edits if edit.kind == "contact"]
    near = np.zeros(len(since), np.bool_)
    if edits and isinstance(stage, Feet):
        stage = copy(stage)
        stage.given = with_contacts(draft.contacts, edits, since)
        before = draft.positions
        vars(draft).update(vars(loose))
        stage.run(draft, progress)
        apart = draft.positions - before
        feet = np.ravel(ankles_and_toes(draft.skeleton))
        moved = np.abs(apart[:, feet]).max(axis=(1, 2)) > _MOVED
        for edit in edits:
            edited = edit.frames(since)
            for span in runs(moved | edited):
                near[span] |= edited[span].any()
    return _from(since, near)


def _away(take: Take, edits: Sequence[Edit]) -> Array:
    """Return the time [s] (T,) from each frame to the nearest edit, inf without any."""
    since = take.time - take.time[0]
    edited = np.zeros(len(since), np.bool_)
    for edit in edits:
        edited |= edit.frames(since)
    return _from(since, edited)


def _from(since: Array, frames: Flags) -> Array:
    """Return the time [s] (T,) from each frame to the nearest of the flagged ones."""
    flagged = np.concatenate([[-np.inf], since[frames], [np.inf]])
    after = np.searchsorted(flagged, since)
    away: Array = np.minimum(flagged[after] - since, since - flagged[after - 1])
    return away


def pin(draft: Draft, pins: Sequence[Edit], before: Unedited) -> None:
    """Move joints to their pins, and the joints beyond them along with them.

    If a limb's end is pinned, its elbow or knee bends as before; restoring bone lengths
    handles what is out of reach. If the trunk is pinned, planted feet stay. A foot that
    a pin raises does not stand. Raises InputError for a pin over 2 m from its joint.
    """
    skeleton, since = draft.skeleton, draft.time - draft.time[0]
    for one in pins:
        joint = one.joints[0]
        place = draft.positions[one.frames(since).argmax(), skeleton.index(joint)]
        if not (far := np.linalg.norm(place - one.position)) <= _FARTHEST:
            raise InputError(
                f"{one.source or one}: {joint} is {far:.1f} m away from there, at "
                f"{place.round(2).tolist()}; pin it within {_FARTHEST:g} m of that, in "
                "meters in the clip's frame of reference"
            )
    # Afterwards, legs of the right length move everything above them as one.
    arms = [k for s in skeleton.sides("Elbow") for k in (s, *skeleton.descendants(s))]
    later = before.done.posed - before.planted.positions
    lift = np.median(np.delete(later, skeleton.legs, axis=1), axis=1)
    positions, weights = draft.positions.copy(), draft.bone_weights.copy()
    origin, stands = draft.origin.copy(), weights >= PLANTED
    for name in dict.fromkeys(pinned.joints[0] for pinned in pins):
        j = skeleton.index(name)
        own = sorted((p for p in pins if p.joints[0] == name), key=lambda p: p.begin)
        places = {int(p.frames(since).argmax()): p.position for p in own}
        frames = list(places)
        away = np.array(list(places.values())) - positions[frames, j]
        if j in arms:
            away -= lift[frames]
        curve = _curve(since[frames], np.column_stack([away, np.ones(len(away))]))
        moves, firm = np.split(curve(np.clip(since, *curve.x[[0, -1]])), [3], axis=1)
        ends = (x for x in limbs(skeleton) if j in skeleton.descendants(x[1]))
        limb = next(ends, None)
        first = j if limb is None else limb[2]
        for k in (first, *skeleton.descendants(first)):
            stays = stands[:, k, None] & (limb is None)
            positions[:, k] += np.where(stays, 0.0, moves)
        if limb is not None:
            _, middle, end = limb
            lengths = (draft.body.lengths[middle], draft.body.lengths[end])
            top, inner, outer = np.moveaxis(positions[:, limb], 1, 0)
            there, _ = middle_joint(top, inner, outer, lengths)
            positions[:, middle] += firm * (there - positions[:, middle])
        weights[:, j] = np.maximum(weights[:, j], PLANTED * firm[:, 0])
        moved = origin[frames, j] == Origin.MEASURED
        origin[np.array(frames)[moved], j] = Origin.CORRECTED
    _, toes = ankles_and_toes(skeleton)
    raised = (positions - draft.positions)[:, toes, 1] > _RAISED
    draft.stands = draft.stands & ~raised
    draft.contacts = draft.contacts & ~raised.repeat(2, axis=1)
    draft.positions, draft.bone_weights, draft.origin = positions, weights, origin


def moved_by_pins(edits: Sequence[Edit], time: Array, skeleton: Skeleton) -> Flags:
    """Return which joints pins move, and when, shape (T, J); time stamps [s] (T,)."""
    moved, since = np.zeros((len(time), len(skeleton)), np.bool_), time - time[0]
    for edit in edits:
        if edit.kind == "pin":
            j = skeleton.index(edit.joints[0])
            middles = (middle for _, middle, _ in limbs(skeleton))
            first = next((k for k in middles if j in skeleton.descendants(k)), j)
            near = np.abs(since - edit.begin) <= _AROUND
            moved[np.ix_(near, [first, *skeleton.descendants(first)])] = True
    return moved


def _curve(times: Array, values: Array) -> Any:  # a CubicHermiteSpline
    """Return a curve through values (N, C) at times [s] (N,), falling to 0 beyond."""
    from scipy.interpolate import CubicHermiteSpline  # takes long to load

    ends = [t + d for t in times for d in (-_AROUND, _AROUND)]
    ends = [t for t in ends if np.abs(times - t).min() >= _AROUND - 1e-6]
    knots = dict.fromkeys(ends, np.zeros_like(values[0]))
    knots |= dict(zip(times, values, strict=True))
    at = sorted(knots)
    rows = np.array([knots[t] for t in at])
    return CubicHermiteSpline(at, rows, np.zeros_like(rows))
