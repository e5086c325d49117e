"""Finds gross failures of the tracker, and lowers reliability where they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from kinefilter.characters import Skeleton, State, Take, Term
from kinefilter.characters.arrays import Flags, runs
from kinefilter.characters.skeleton import SIDES
from kinefilter.pipeline.reliability import Scores

from .bodies import elsewhere, of_another_size
from .limbs import bent_backwards, leaps, leftward, out_of_range, through_head

_SPIN = np.radians(120.0)
_SPIN_TIME = 1.0 / 6.0
"""Nobody turns the trunk by this angle [rad] in this time [s], which is two revolutions
a second: figure skaters reach six, dancers two."""
_MENDS = 0.7
"""Exchanging the sides has to reduce the jumps into and out of a mirrored stretch to
this share or less. A guess."""
_LONG = 0.8  # s: a knee bent backwards for less is noise, or a kick seen from the front
_SHORT = 0.3  # s: an arm in an impossible place for less only brushes by

_TOLD = 5  # stretches of one kind; of more their number says enough


class FailureKind(StrEnum):
    """What is wrong with part of a take."""

    MIRRORED = "left and right exchanged"
    BENT_BACKWARDS = "bent backwards at the knee"
    THROUGH_HEAD = "through the head"
    OUT_OF_RANGE = "beyond the shoulder's range"
    LEAPING = "leaping faster than limbs move"
    DISPLACED = "displaced by 9 cm or more"
    ELSEWHERE = "where it cannot have been"
    ODD_SIZE = "far larger or smaller than it is"
    JUMPING = "jumping faster than people move"

    @property
    def done(self) -> str:
        """What cleaning does about it, for users."""
        return _DONE.get(self, "left as measured, check it")


_DONE = {
    FailureKind.MIRRORED: "exchanged back if that makes it go on smoothly",
    FailureKind.BENT_BACKWARDS: "not trusted, made up from the rest of the body",
    FailureKind.THROUGH_HEAD: "not trusted, made up from the rest of the body",
    FailureKind.DISPLACED: "moved to where the rest says it was, check it",
    FailureKind.ELSEWHERE: "taken out and filled in from before and after",
    FailureKind.ODD_SIZE: "taken out and filled in from before and after",
    FailureKind.JUMPING: "left as measured; if it is somebody else, cut the take there",
}

_NOBODY = (FailureKind.ELSEWHERE, FailureKind.ODD_SIZE)
"""Failures whose frames hold nothing of the person."""
_DOUBTED = (FailureKind.BENT_BACKWARDS, FailureKind.THROUGH_HEAD)
"""Failures whose limbs get reliability 0. An arm beyond its range is closer to the
truth than what correction invents for it: 27 against 39 cm in 14 recorded clips. A limb
that leaps may be right before or after the leap: distrusting it removed real kicks."""


@dataclass(frozen=True)
class Failure:
    """A stretch of a take in which the tracker failed."""

    kind: FailureKind
    """What is wrong."""
    part: str
    """What it is wrong with: ``body``, or ``left`` or ``right`` and ``arm`` or
    ``leg``."""
    first: int
    """Its first frame."""
    last: int
    """Its last frame."""
    start: float
    """Time stamp of the first frame [s]."""
    end: float
    """Time stamp of the last frame [s]."""

    @property
    def frames(self) -> slice:
        """Its frames."""
        return slice(self.first, self.last + 1)

    def moved(self, frames: int) -> Failure:
        """Return the failure counted from another frame."""
        return replace(self, first=self.first + frames, last=self.last + frames)

    def __str__(self) -> str:
        return f"{self.part} {self.kind} from {self.start:.1f} to {self.end:.1f} s"


def told_failures(failures: Iterable[Failure], begin: float) -> tuple[str, ...]:
    """Return a sentence for each kind of failure and part: when, and what is done.

    Times are since ``begin``, the time stamp of the first frame [s].
    """
    alike: dict[tuple[str, FailureKind], list[Failure]] = {}
    for failure in failures:
        alike.setdefault((failure.part, failure.kind), []).append(failure)
    sentences = []
    for (part, kind), same in alike.items():
        times = [(f.start - begin, f.end - begin) for f in same[:_TOLD]]
        when = ", ".join(f"{start:.1f} to {end:.1f}" for start, end in times)
        more = f" and {len(same) - _TOLD} times later" if len(same) > _TOLD else ""
        sentences.append(f"{part} {kind} ({when} s{more}): {kind.done}")
    return tuple(sentences)


def find_failures(take: Take) -> tuple[Failure, ...]:
    """Return the gross failures in a take, time stamps strictly increasing."""
    if len(take) < 2:
        return ()
    kind = FailureKind
    found = list(_lasting(take, kind.ODD_SIZE, "body", of_another_size(take)))
    take = without_nobody(take, found)
    wrong, jumps = elsewhere(take)
    found += _lasting(take, kind.ELSEWHERE, "body", wrong)
    found += _lasting(take, kind.JUMPING, "body", jumps)
    take = without_nobody(take, found)
    found += _lasting(take, kind.MIRRORED, "body", _mirrored(take))
    take = unmirrored(take, found)  # sides are named as they are once exchanged back
    for side in SIDES:
        for limb, what, frames, shortest in (
            ("arm", kind.THROUGH_HEAD, through_head(take, side), _SHORT),
            ("arm", kind.OUT_OF_RANGE, out_of_range(take, side), _SHORT),
            ("arm", kind.LEAPING, leaps(take, side, "arm"), 0.0),
            ("leg", kind.BENT_BACKWARDS, bent_backwards(take, side), _LONG),
            ("leg", kind.LEAPING, leaps(take, side, "leg"), 0.0),
        ):
            found += _lasting(take, what, f"{side.lower()} {limb}", frames, shortest)
    return tuple(sorted(found, key=lambda failure: failure.first))


def _lasting(
    take: Take, kind: FailureKind, part: str, frames: Flags, shortest: float = 0.0
) -> Iterable[Failure]:
    """Yield the stretches of a failure in frames (T,), none shorter than that [s]."""
    for run in runs(frames):
        start, end = float(take.time[run.start]), float(take.time[run.stop - 1])
        if end - start >= shortest:
            yield Failure(kind, part, run.start, run.stop - 1, start, end)


def distrust(
    scores: Scores, failures: tuple[Failure, ...], skeleton: Skeleton
) -> Scores:
    """Return scores with a reliability of 0 where a limb is in an impossible place.

    This holds from the elbow or knee on. Mirrored bodies are put back before; arms
    beyond their range and limbs that leap keep their reliability.
    """
    reliability, geometry = scores.reliability.copy(), scores.geometry.copy()
    term = scores.term.copy()
    for failure in failures:
        if failure.kind in _NOBODY:
            term[failure.frames] = Term.FAILURE
        if failure.kind in _DOUBTED:
            side, limb = failure.part.split()
            top = {"arm": "Shoulder", "leg": "Hip"}[limb] + side.capitalize()
            joints = skeleton.beyond(skeleton.index(top))
            reliability[failure.frames, joints] = 0.0
            geometry[failure.frames, joints] = 0.0
            term[failure.frames, joints] = Term.FAILURE
    return replace(scores, reliability=reliability, geometry=geometry, term=term)


def _mirrored(take: Take) -> Flags:
    """Return the frames, fewer than half, between impossible turns, shape (T,)."""
    frames = np.zeros(len(take), dtype=bool)
    left = np.nan_to_num(leftward(take)[:, [0, 2]])
    lag = max(1, round(_SPIN_TIME * len(take) / (take.time[-1] - take.time[0])))
    if len(take) <= lag:
        return frames
    norms = np.maximum(np.linalg.norm(left, axis=1), 1e-9)
    cosines = np.sum(left[lag:] * left[:-lag], axis=1) / (norms[lag:] * norms[:-lag])
    # A turn shows in all pairs of frames that have it between them.
    spins = runs(cosines < np.cos(_SPIN))
    turns = [(run.start + run.stop - 1) // 2 + lag // 2 + 1 for run in spins]
    for k, turn in enumerate(turns):
        end = turns[k + 1] if k + 1 < len(turns) else len(take)
        frames[turn:end] = k % 2 == 0
    return frames if frames.mean() <= 0.5 else ~frames


def without_nobody(take: Take, failures: Iterable[Failure]) -> Take:
    """Return a take in which every joint is missing where the person cannot have been.

    That is in frames with the body elsewhere or of another size.
    """
    frames = np.zeros(len(take), dtype=bool)
    for failure in failures:
        frames[failure.frames] |= failure.kind in _NOBODY
    if not frames.any():
        return take
    positions = np.where(frames[:, None, None], np.nan, take.positions)
    state = np.where(frames[:, None], State.NOT_TRACKED, take.state)
    return replace(take, positions=positions, state=state.astype(np.uint8))


def unmirrored(take: Take, failures: Iterable[Failure]) -> Take:
    """Return a take whose left and right are exchanged back where they were mirrored.

    Where the body would jump as far either way, more is wrong, and they stay.
    """
    frames = np.zeros(len(take), dtype=bool)
    for failure in failures:
        if failure.kind is FailureKind.MIRRORED:
            first, last = failure.first, failure.last
            edges = [(first, first - 1), (last, last + 1)]
            edges = [edge for edge in edges if 0 <= edge[1] < len(take)]
            jumps = sum(_jump(take, *edge, mirror=False) for edge in edges)
            mended = sum(_jump(take, *edge, mirror=True) for edge in edges)
            frames[failure.frames] = mended < _MENDS * jumps
    return take.exchanged(frames) if frames.any() else take


def _jump(take: Take, inside: int, outside: int, *, mirror: bool) -> float:
    """Return how far joints move relative to the root between two frames, mean [m].

    0 if no joint, or not the root, is seen in both.
    """
    root = take.skeleton.root
    frame, other = (
        take.positions[k] - take.positions[k, root] for k in (inside, outside)
    )
    if mirror:
        frame = frame[take.skeleton.mirror]
    away = np.linalg.norm(frame - other, axis=1)
    known = away[np.isfinite(away)]
    return float(known.mean()) if len(known) else 0.0
