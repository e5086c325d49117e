"""The cleaner: the list of stages that every take and every live frame passes through.

This is the only place that knows their order. ``clean`` runs the list over a whole
take; ``Avatar`` and ``live`` step through it frame by frame; ``bench`` times its
entries; ``evaluate`` replaces one of them and measures the final result.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import TRACKINGS, Body, Clip, InputError, Take, Tracking
from kinefilter.characters.arrays import (
    Array,
    as_number,
    check_choice,
    check_kind,
    runs,
)
from kinefilter.characters.gaps import describe_gaps, long_gaps, parts_of
from kinefilter.characters.motion import LATEST_TIME_STAMP

from .checks import check_take, checked_frame
from .config import CleanConfig
from .correct import Corrector
from .draft import Draft, Unedited
from .editing import clean_again, unedited
from .edits import Edit, check_edits, read_edits
from .failures import Failure, describe_failures, find_displaced
from .formats.plain import times_told
from .metrics import Quality, distances, measure
from .physics import PhysicsTrace
from .physics.stage import Physics
from .progress import Progress, silent
from .reconstruct import Reconstruct
from .stages import (
    Correct,
    Failures,
    MeasureBody,
    MeasureCorrectedBody,
    Score,
    SharedStage,
    Stage,
    Standardize,
)
from .target.aim_stages import AimHands, AimHead
from .target.floor import to_world
from .target.target_stages import Bones, Feet, Floor, Level, Orient, Smooth, Upright
from .uncertainty import uncertainty

_Passing = tuple[Take, Any, Draft]  # recorded frames, index of all, working state
_LONGEST_STEP = 0.5  # s; a longer pause in the stream counts as this much motion
_OUT_OF_REACH = 0.1  # m from a pin at which its joint is told. A guess


@dataclass(frozen=True, eq=False)
class CleanResult:
    """A cleaned clip and a record of how it came about."""

    clip: Clip
    """The cleaned motion."""
    target: Array
    """Joint positions [m] before physics, in the clip's frame, shape (T, J, 3)."""
    stages: dict[str, Quality]
    """Quality of ``raw``, ``corrected`` and, unless switched off, ``physics``. Raw is
    the take as recorded, even where swapped sides were put right."""
    coverage: Array
    """How well the method knows each frame's posture, in [0, 1] or NaN, shape (T,)."""
    trace: PhysicsTrace | None
    """What the simulation did at each distinct time stamp; None without physics."""
    failures: tuple[Failure, ...]
    """Tracker failures and limbs that moved far; frames count distinct time stamps."""
    notes: tuple[str, ...]
    """What the user should know about this take."""
    clips: tuple[Clip, ...]
    """The clips to write: ``clip`` itself, or its parts with ``gaps="split"``."""

    @property
    def damage(self) -> tuple[str, ...]:
        """Long gaps and tracker failures, with times and remedies, a sentence each."""
        begin = self.clip.time[0]
        gaps = describe_gaps(long_gaps(self.clip.time), begin)
        return (*gaps, *describe_failures(self.failures, begin))

    @property
    def share_outside(self) -> float:
        """Share of frames whose coverage is below 0.5, or NaN without coverage."""
        outside = np.where(np.isnan(self.coverage), np.nan, self.coverage < 0.5)
        return float(np.mean(outside))


class Cleaner:
    """Cleans whole takes, or a live stream frame by frame, with one list of stages.

    Args:
        config: Settings; the default is the shipped learned correction followed by
            local PCA and physics.
        tracking: Gains that pull the simulated character, instead of the config's.
        corrector: Corrector to use instead of the config's method.
    """

    def __init__(
        self,
        config: CleanConfig | None = None,
        *,
        tracking: Tracking | None = None,
        corrector: Corrector | None = None,
    ) -> None:
        config = CleanConfig() if config is None else config
        check_kind(config, CleanConfig, "the config")
        check_kind(tracking, Tracking | None, "the tracking")
        check_kind(corrector, Corrector | None, "the corrector")
        if tracking is None:
            tracking = replace(TRACKINGS[config.tracking], **config.parameters.tracking)
        stages: tuple[Stage, ...] = (
            Upright(config),  # turn the frame of a strongly tilted or inverted sensor
            Failures(),  # swap sides back, drop impossible bodies, mark bad limbs
            MeasureBody(config),  # measure the person's segment lengths
            Score(config),  # rate the reliability of every joint
            Reconstruct(config),  # fill hidden limbs from their motion before and after
            Standardize(),  # map to the standard body, root at the origin, facing +z
            Correct(config, corrector),  # correct unreliable joints, map back
            MeasureCorrectedBody(config),  # measure the segments again, as corrected
            Level(config),  # find the stances, and level the floor under them
            Smooth(config),  # smooth the joints, slow ones most
            Floor(config),  # put the floor at y = 0, under the planted feet
            Feet(config),  # hold planted feet in place, lift stepping ones
            Bones(),  # restore the person's own segment lengths
            Orient(),  # compute a rotation for every segment
            AimHead(),  # aim the head by all joints above the shoulders
            AimHands(),  # aim hands by all their joints, twist forearms by the thumbs
            Physics(config, tracking),  # pull a simulated character through the motion
        )
        enabled = {"physics": config.physics, "reconstruct": config.reconstruct}
        enabled["failures"] = config.preset is None  # no paper repairs its input
        self.stages = tuple(s for s in stages if enabled.get(s.name, True))
        self._gaps = config.gaps
        self._edits = read_edits(config.edits) if config.edits else ()
        self._time: float | None = None
        self._bodies: list[Body] = []  # what each stage knows of the person

    def replaced(self, *stages: Stage) -> Cleaner:
        """Return a copy with stages replaced by name; raises InputError if unknown."""
        for stage in stages:
            check_kind(stage, Stage, "a stage")
        return self._changed((stage.name, stage) for stage in stages)

    def without(self, *names: str) -> Cleaner:
        """Return a copy without the named stages; errors as for ``replaced``."""
        return self._changed((name, None) for name in names)

    def until(self, name: str) -> Cleaner:
        """Return a copy that ends with the named stage; errors as for ``replaced``."""
        names = [stage.name for stage in self.stages]
        check_choice(name, names, "stage")
        return self.without(*names[names.index(name) + 1 :])

    def _changed(self, changes: Iterable[tuple[str, Stage | None]]) -> Cleaner:
        """Return a copy with stages replaced by name, or left out where None."""
        stages: dict[str, Stage | None] = {stage.name: stage for stage in self.stages}
        for name, stage in changes:
            check_choice(name, stages, "stage")
            stages[name] = stage
        other = copy(self)
        other.stages = tuple(stage for stage in stages.values() if stage is not None)
        other._time, other._bodies = None, []
        return other

    def measure(self, take: Take) -> tuple[Body, Body]:
        """Return the body of a person in a take, and the same as the sensor shows it.

        Both are for ``start``; a second of frames is enough. Errors as for ``clean``.
        """
        draft, bodies = Draft.of(self._distinct(take)[0]), list[Body]()
        for stage in self.until(MeasureCorrectedBody.name).stages:
            stage.run(draft, silent)
            if stage.name in (MeasureBody.name, MeasureCorrectedBody.name):
                bodies.append(draft.body)
        return bodies[-1], bodies[0]

    def start(self, body: Body, measured: Body | None = None) -> None:
        """Reset the state for a new motion of a body, to be passed to ``step``.

        ``measured`` has the person's segment lengths as the sensor shows them, which
        correction needs; by default they are those of ``body``.
        """
        check_kind(body, Body, "the body")
        check_kind(measured, Body | None, "the measured body")
        self._bodies, self._time = [], None
        shown = measured or body
        for stage in self.stages:
            if stage.name == MeasureCorrectedBody.name:
                shown = body
            self._bodies.append(shown)
            stage.start(shown)

    def step(
        self, positions: ArrayLike, time: float, state: ArrayLike | None = None
    ) -> Draft:
        """Pass the next frame through the stages, without looking ahead.

        Joint positions [m] (J, 3) are in the sensor frame with y up, NaN where missing;
        the tracking states (State) (J,) are by default tracked wherever there is a
        position. The time stamp [s] is later than that of the previous frame.

        Returns the working state after all stages, with the simulated character's
        ``positions`` and ``rotations``. Raises an InputError for a wrong shape or time,
        positions that are not numbers, or if ``start`` was not called.
        """
        if not self._bodies:
            raise InputError("step() has no body; call start(body) first")
        skeleton = self._bodies[-1].skeleton
        time = as_number(time, "the time of a frame")
        measured, states = checked_frame(positions, state, skeleton)
        if not abs(time) < LATEST_TIME_STAMP:
            raise InputError(f"a frame at {time:g} s; give its time stamp in seconds")
        if self._time is not None and time <= self._time:
            raise InputError(
                f"a frame at {time:g} s comes after one at {self._time:g} s; give "
                "increasing time stamps in seconds, or call start() first"
            )
        draft = Draft(skeleton, time, measured, states)
        if self._time is not None:
            draft.elapsed = min(time - self._time, _LONGEST_STEP)
        self._time = time
        for stage, draft.body in zip(self.stages, self._bodies, strict=True):
            if draft.appears and not stage.continues:
                stage.start(draft.body)
            stage.step(draft)
        return draft

    def whole(self, take: Take, progress: Progress = silent) -> Draft:
        """Pass a take with strictly increasing time stamps through the stages."""
        check_kind(take, Take, "the take")
        draft = Draft.of(take)
        for stage in self.stages:
            stage.run(draft, progress)
        return draft

    def unedited(self, take: Take, progress: Progress = silent) -> Unedited:
        """Clean a take without edits, as the ``before`` of later ``clean`` calls."""
        return unedited(self.stages, self._distinct(take)[0], progress)

    def _distinct(self, take: Take) -> tuple[Take, Any]:
        """Return the frames with distinct time stamps, and an index that restores all.

        Raises an InputError if there is nothing to clean, or a long gap to refuse.
        """
        check_take(take)
        if self._gaps == "refuse" and (gaps := long_gaps(take.time)):
            raise InputError(
                f"{take.source}: {describe_gaps(gaps, take.time[0])[0]}; clean it with "
                "--gaps hold or split, or cut the take there"
            )
        distinct = np.concatenate([[True], np.diff(take.time) > 0])
        if distinct.all():
            return take, slice(None)  # which copies nothing
        return take.at(distinct), np.cumsum(distinct) - 1

    def clean(
        self,
        take: Take,
        *,
        edits: Sequence[Edit] | None = None,
        before: Unedited | None = None,
        progress: Progress = silent,
    ) -> CleanResult:
        """Clean a take, with manual corrections: by default the config's edits.

        With ``before``, a result of ``unedited``, only edited parts are cleaned again.
        ``progress`` wraps the frame loops. Raises an InputError if there is nothing to
        clean or a long gap to refuse, or the database or the edits do not fit the take.
        """
        edits = self._edits if edits is None else tuple(edits)
        recorded, frames = self._distinct(take)
        if edits:
            check_edits(recorded, edits)  # before any work is done
            before = before or self.unedited(take, progress)
            draft = clean_again(self.stages, recorded, edits, before, progress)
        else:
            draft = before.done if before else self.whole(recorded, progress)
        return self._result(take, recorded, frames, draft, edits)

    def clean_together(
        self, takes: Sequence[Take], *, progress: Progress = silent
    ) -> Iterator[CleanResult | InputError]:
        """Clean the takes of people of one recording, and yield the results in order.

        They share the sensor's tilt and, with a scene, a simulated world, where they
        push each other and the props. In place of the result of a take that cannot be
        cleaned is the error; the others go on without it.
        """
        # All people pass the last stage that they share before any goes on alone.
        shared = [isinstance(s, SharedStage) and s.shared for s in self.stages]
        count = len(shared) - shared[::-1].index(True) if any(shared) else 0
        found = [self._started(take) for take in takes]
        for stage in self.stages[:count]:
            present = [one for one in found if not isinstance(one, InputError)]
            if isinstance(stage, SharedStage) and present:
                stage.together([draft for _, _, draft in present], progress)
            else:
                found = [_passed(one, (stage,), progress) for one in found]
        for take in takes:
            one = _passed(found.pop(0), self.stages[count:], progress)
            if isinstance(one, InputError):
                yield one
            else:
                yield self._result(take, *one, ())

    def _started(self, take: Take) -> _Passing | InputError:
        try:
            recorded, frames = self._distinct(take)
        except InputError as error:
            return error
        return recorded, frames, Draft.of(recorded)

    def _result(
        self,
        take: Take,
        recorded: Take,
        frames: Any,
        draft: Draft,
        edits: Sequence[Edit],
    ) -> CleanResult:
        # From here on: clip, quality, failures and notes of what the stages made.
        measured = to_world(draft.measured, draft.tilt, draft.floor)
        moved_by_correction = distances(draft.posed, measured)
        displaced = find_displaced(
            draft.time, measured, draft.posed, draft.heading.yaw, take.skeleton
        )
        del measured
        tilt, roll = draft.turn.tilt + draft.tilt, draft.turn.roll
        raw = to_world(recorded.positions, tilt, draft.floor, roll)
        motions = {"raw": raw, "corrected": draft.posed}
        final, force = draft.posed, np.full(len(raw), np.nan)
        if draft.trace is not None:
            motions["physics"] = final = draft.positions
            force = draft.trace.external_force
        stages = {
            name: measure(draft.time, positions, raw, draft.body, draft.stands)
            for name, positions in motions.items()
        }
        split = self._gaps == "split"
        then = ": the next clip begins" if split else ": the character holds still"
        clip = Clip(
            time=take.time,
            root=final[frames, take.skeleton.root],
            rotations=draft.rotations[frames],
            body=draft.body,
            state=take.state,
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
                *_notes(draft),
            ),
            tuple(map(clip.at, parts_of(clip.time))) if split else (clip,),
        )


def _passed(
    one: _Passing | InputError, stages: Sequence[Stage], progress: Progress
) -> _Passing | InputError:
    """Return a person after further stages, or the error."""
    if not isinstance(one, InputError):
        try:
            for stage in stages:
                stage.run(one[2], progress)
        except InputError as error:
            return error
    return one


def clean(
    take: Take, config: CleanConfig | None = None, *, progress: Progress = silent
) -> CleanResult:
    """Clean one take; a ``Cleaner`` loads its methods once for many takes."""
    return Cleaner(config).clean(take, progress=progress)


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
    yield from draft.turn.notes(draft.tilt)
    if draft.turn.roll:
        yield "--tilt 0 leaves the sensor's frame as it is"
    if draft.trace is not None and draft.trace.reset.any():
        starts = [draft.time[k.start] - draft.time[0] for k in runs(draft.trace.reset)]
        yield (
            f"physics: {draft.trace.status}, {times_told([(t, t) for t in starts])}: "
            "before that the clip shows the target; if a limb is wrong in it, distrust "
            "that limb with --edits"
        )
