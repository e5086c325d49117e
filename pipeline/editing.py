"""Cleans a take again where somebody said something of it, and nowhere else.

Half a second around an edit, what is cleaned with it and without it fade into each
other; farther away nothing moves. What is measured on the whole take, such as the body
and the floor, is that of the take without edits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.rotations import continuous, normalize
from kinefilter.retarget.stance import smooth_step

from .draft import Draft, Unedited
from .edits import Edit, with_contacts
from .progress import Progress
from .stages import Stage
from .target.feet import ankles_and_toes
from .target.pins import pin
from .target.stages import Feet

_WHOLLY = 0.15  # s around an edit in which what is cleaned with it counts alone
_FADED = 0.4  # s around it from where on it no longer counts: physics lags behind
_AROUND = 0.5  # s around an edit in which anything moves
_SETTLED = 0.2  # s at the end of that in which physics joins what it was
_CONTEXT = 1.0  # s more that stages are given: smoothing and physics come from before
_MOVED = 1e-4  # m
_OF_TAKE = ("distrust", "exchange")  # edits by which the take itself is another one


def unedited(stages: Sequence[Stage], take: Take, progress: Progress) -> Unedited:
    """Pass a take through the stages, and keep what is needed to do some again."""
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
    """Return the draft of an edited take.

    Args:
        stages: All that there are, in their order.
        take: The take, with its sides and without its joints as the edits have it.
        edits: What is said of it.
        before: The take without edits.
        progress: Wraps the frame loops.
    """
    names = [stage.name for stage in stages]
    correct, feet = names.index("correct"), names.index("feet")
    away = _away(take, [edit for edit in edits if edit.kind in _OF_TAKE])
    seen, draft = Draft.of(take), copy(before.corrected)
    seen.unedited = draft.unedited = before
    seen.failures = before.done.failures
    if np.isfinite(away).any():
        for stage in stages[:correct]:
            stage.run(seen, progress)
        for part, frames in _again([stages[correct]], seen, away, progress):
            draft.put(part, frames, away <= _AROUND)
    away = _away(take, edits)
    for stage in stages[correct + 1 : feet]:
        stage.run(draft, progress)
    away = np.minimum(
        away, _planted(stages[feet], draft, edits, before.planted, progress)
    )
    pin(draft, [edit for edit in edits if edit.kind == "pin"])
    share = smooth_step((_FADED - away) / (_FADED - _WHOLLY))[:, None]
    old, planted = before.planted, copy(before.planted)
    planted.put(draft, slice(None), away < 0.5 * (_WHOLLY + _FADED))
    planted.bone_weights = old.bone_weights + share * (
        draft.bone_weights - old.bone_weights
    )
    planted.positions = old.positions + share[..., None] * (
        draft.positions - old.positions
    )
    done, later = copy(before.done), stages[feet + 1 :]
    for part, frames in _again(later, planted, away, progress):
        if not all(stage.local for stage in later):
            done = part
        else:
            _fade(part, before.done.part(frames), away[frames])
            done.put(part, frames, away <= _AROUND)
    done.rotations = continuous(done.rotations)
    near = away <= _AROUND
    done.failures = (
        *(f for f in before.done.failures if not near[f.first : f.last + 1].any()),
        *(f for f in seen.failures if near[f.first : f.last + 1].any()),
    )
    return done


def _again(
    stages: Sequence[Stage], draft: Draft, away: Array, progress: Progress
) -> Iterator[tuple[Draft, slice]]:
    """Yield what stages make of a take near its edits, and of which frames."""
    spans = runs(away <= _AROUND + _CONTEXT)
    if not all(stage.local for stage in stages):
        spans = [slice(0, len(draft.time))]
    for frames in spans:
        part = draft.part(frames)
        for stage in stages:
            stage.run(part, progress)
        yield part, frames


def _fade(part: Draft, before: Draft, away: Array) -> None:
    """Let the motion of a part, which physics has bent, end where it was before."""
    share = smooth_step((_AROUND - away) / _SETTLED)[:, None, None]
    near = np.vecdot(part.rotations, before.rotations)[..., None] < 0.0
    turned = np.where(near, -part.rotations, part.rotations)
    part.rotations = normalize(before.rotations + share * (turned - before.rotations))
    for name in ("positions", "posed"):
        old, new = getattr(before, name), getattr(part, name)
        setattr(part, name, old + share * (new - old))


def _planted(
    stage: Stage, draft: Draft, edits: Sequence[Edit], before: Draft, progress: Progress
) -> Array:
    """Plant the feet of a take as they are said to stand.

    Returns how far away in time [s] (T,) it is that a foot moves for that: it stands
    elsewhere for as long as it stands.
    """
    loose, since = copy(draft), draft.time - draft.time[0]
    stage.run(draft, progress)
    told = [edit for edit in edits if edit.kind == "contact"]
    away = np.full(len(since), np.inf)
    if not told or not isinstance(stage, Feet):
        return away
    stage = copy(stage)
    stage.given = with_contacts(draft.contacts, told, since)
    vars(draft).update(vars(loose))
    stage.run(draft, progress)
    apart = draft.positions - before.positions
    feet = np.ravel(ankles_and_toes(draft.skeleton))
    moved = np.abs(apart[:, feet]).max(axis=(1, 2)) > _MOVED
    for edit in told:
        edited = edit.frames(since)
        for span in runs(moved | edited):
            if edited[span].any():
                away[span] = 0.0
    return _from(since, away == 0.0)


def _away(take: Take, edits: Sequence[Edit]) -> Array:
    """Return how far each frame is [s] (T,) from the nearest edit, inf without any."""
    since = take.time - take.time[0]
    frames = [edit.frames(since) for edit in edits]
    return _from(since, np.any([np.zeros(len(since), np.bool_), *frames], axis=0))


def _from(since: Array, frames: Flags) -> Array:
    """Return how far each frame is [s] (T,) from the nearest of some."""
    some = np.concatenate([[-np.inf], since[frames], [np.inf]])
    after = np.searchsorted(some, since)
    away: Array = np.minimum(some[after] - since, since - some[after - 1])
    return away
