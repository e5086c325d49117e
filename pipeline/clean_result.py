"""What cleaning a take gives: the clip, its quality, failures, and notes on both."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinefilter.characters import Clip, Take
from kinefilter.characters.arrays import Array, runs
from kinefilter.characters.gaps import describe_gaps, long_gaps, parts_of

from .draft import Draft
from .editing import moved_by_pins
from .edits import Edit
from .failures import Failure, describe_damage, find_displaced
from .formats.plain import times_told
from .formats.recording import far_joints, far_notes
from .metrics import Quality, distances, measure
from .physics import PhysicsTrace
from .target.floor import to_world
from .uncertainty import uncertainty

_GONE = 1.0  # s without any joint, in frames that are there, that are told. A guess
_OUT_OF_REACH = 0.1  # m from a pin at which its joint is told. A guess


@dataclass(frozen=True, eq=False, repr=False)
class CleanResult:
    """A cleaned clip and a record of how it came about.

    Attributes:
        clip: The cleaned motion.
        target: Joint positions [m] before physics, in the clip's frame, shape
            (T, J, 3).
        stages: Quality of ``raw``, ``corrected`` and, unless switched off, ``physics``.
            Raw is the take as recorded, even where swapped sides were put right.
        coverage: How well the method knows each frame's posture, in [0, 1] or NaN,
            shape (T,).
        trace: What the simulation did at each distinct time stamp; None without
            physics.
        failures: Tracker failures and limbs that moved far; frames count distinct time
            stamps.
        notes: What the user should know about this take.
        clips: The clips to write: ``clip`` itself, or its parts with ``gaps="split"``.
    """

    clip: Clip
    target: Array
    stages: dict[str, Quality]
    coverage: Array
    trace: PhysicsTrace | None
    failures: tuple[Failure, ...]
    notes: tuple[str, ...]
    clips: tuple[Clip, ...]

    def __repr__(self) -> str:
        return f"<CleanResult with {self.clip!r}>"

    @property
    def damage(self) -> tuple[str, ...]:
        """Long gaps and tracker failures, with times and remedies, a sentence each."""
        return describe_damage(self.clip.time, self.failures)

    @property
    def share_outside(self) -> float:
        """Share of frames whose coverage is below 0.5, or NaN without coverage."""
        outside = np.where(np.isnan(self.coverage), np.nan, self.coverage < 0.5)
        return float(np.mean(outside))


def result_of(
    take: Take,
    recorded: Take,
    frames: Any,
    draft: Draft,
    edits: Sequence[Edit],
    *,
    split: bool,
) -> CleanResult:
    """Return what the stages made of a take, with a clip for each part if ``split``.

    ``recorded`` and ``draft`` have its frames with distinct time stamps, and ``frames``
    is the index that restores all.
    """
    far = far_joints(take.positions)
    measured = to_world(draft.measured, draft.tilt, draft.floor, draft.roll)
    moved_by_correction = distances(draft.posed, measured)
    measured[moved_by_pins(edits, draft.time, take.skeleton)] = np.nan
    tilt, roll = draft.turn.tilt + draft.tilt, draft.turn.roll + draft.roll
    raw = to_world(recorded.positions, tilt, draft.floor, roll)
    motions = {"raw": raw, "corrected": draft.posed}
    final, force = draft.posed, np.full(len(raw), np.nan)
    if draft.trace is not None:
        motions["physics"] = final = draft.positions
        force = draft.trace.external_force
    mended = replace(recorded, positions=measured)
    displaced = tuple(find_displaced(mended, final))
    del measured, mended
    stages = {
        name: measure(draft.time, positions, raw, draft.body, draft.stands)
        for name, positions in motions.items()
    }
    then = ": the next clip begins" if split else ": the character holds still"
    clip = Clip(
        time=take.time,
        root=final[frames, take.skeleton.root],
        rotations=draft.rotations[frames],
        body=draft.body,
        state=take.without(far).state,
        reliability=draft.reliability[frames],
        deciding_term=draft.deciding_term[frames],
        origin=draft.origin[frames],
        moved_by_correction=moved_by_correction[frames],
        moved_by_physics=distances(final, draft.posed)[frames],
        uncertainty=uncertainty(draft)[frames],
        contacts=draft.contacts[frames],
        external_force=force[frames],
        props=tuple(prop.at(frames) for prop in draft.props),
        source=take.source,
        tilt=tilt,
        floor=draft.floor,
        roll=roll,
    )
    return CleanResult(
        clip,
        draft.posed[frames],
        stages,
        draft.coverage[frames],
        draft.trace,
        tuple(sorted((*draft.failures, *displaced), key=lambda f: f.first)),
        (
            *(_told(edit, draft, final) for edit in edits),
            *describe_gaps(long_gaps(take.time), take.time[0], then),
            *far_notes(take.time, far, take.skeleton),
            *_notes(draft),
        ),
        tuple(map(clip.at, parts_of(clip.time))) if split else (clip,),
    )


def _told(edit: Edit, draft: Draft, final: Array) -> str:
    """Return a note on an edit, and how far from its pin a joint out of reach is."""
    if edit.kind != "pin":
        return str(edit)
    frame = int(edit.frames(draft.time - draft.time[0]).argmax())
    place = final[frame, draft.skeleton.index(edit.joints[0])]
    short = float(np.linalg.norm(place - edit.position))
    reach = f": {short:.1f} m short; pin it where the body reaches"
    return f"{edit}{reach if short > _OUT_OF_REACH else ''}"


def _notes(draft: Draft) -> Iterable[str]:
    """Yield what the user should know about how a take was cleaned."""
    if not draft.reference.from_reference_posture:
        yield (
            "no T-pose or standing frames with every joint tracked: segment lengths "
            "are measured over the whole take"
        )
    joints = draft.skeleton.joints
    if unseen := [joints[j] for j in np.flatnonzero(draft.missing.all(axis=0))]:
        yield f"never tracked, so a guess: {', '.join(unseen)}"
    since = draft.time - draft.time[0]
    nobody = np.asarray(draft.missing.all(axis=1))
    gone = [(since[k.start], since[k.stop - 1]) for k in runs(nobody)]
    if gone := [(begin, end) for begin, end in gone if end - begin > _GONE]:
        yield f"nobody in view, so a guess: {times_told(gone)}"
    yield from draft.turn.notes(draft.tilt, draft.roll)
    if draft.turn.roll:
        yield "--tilt 0 leaves the sensor's frame as it is"
    if draft.trace is not None and draft.trace.reset.any():
        starts = [draft.time[k.start] - draft.time[0] for k in runs(draft.trace.reset)]
        yield (
            f"physics: {draft.trace.status}, {times_told([(t, t) for t in starts])}: "
            "about then the clip shows the target; if a limb is wrong in it, distrust "
            "that limb with --edits"
        )
