"""The cleaner: the stages that a take or a frame passes, in their order.

Nothing else knows the order: ``clean`` runs the list over a take, ``Avatar`` and
``live`` step it frame by frame, ``bench`` times its entries, and ``evaluate`` swaps one
entry and measures what comes out at the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import TRACKINGS, Body, Clip, InputError, Take, Tracking
from kinefilter.characters.arrays import Array, as_number, check_kind, check_word
from kinefilter.characters.gaps import long_gaps, parts_of, told_gaps
from kinefilter.characters.motion import LATEST

from .checks import check_take, checked_frame
from .config import CleanConfig
from .correct import Corrector
from .draft import Draft, Unedited
from .editing import clean_again, unedited
from .edits import Edit, edited, read_edits
from .failures import Failure, find_displaced, told_failures
from .metrics import Quality, distances, measure
from .physics import PhysicsTrace
from .progress import Progress, silent
from .reconstruct import Reconstruct
from .stages import (
    Correct,
    Failures,
    MeasureBody,
    MeasureCorrectedBody,
    Physics,
    Score,
    Stage,
    Standardize,
)
from .target.floor import to_world
from .target.stages import Bones, Feet, Floor, Level, Orient, Smooth, Upright
from .uncertainty import uncertainty

_LONGEST_STEP = 0.5  # s: a pause in the stream is no time in which to move


@dataclass(frozen=True, eq=False)
class CleanResult:
    """A cleaned clip and what happened on the way."""

    clip: Clip
    """The motion."""
    target: Array
    """Joint positions [m] before physics, the clip's frame, shape (T, J, 3)."""
    stages: dict[str, Quality]
    """Quality of ``raw``, ``corrected`` and, unless switched off, ``physics``; raw is
    the take as it was recorded, also where sides were put back."""
    coverage: Array
    """How well the database knows the posture of each frame, in [0, 1], shape (T,);
    NaN where the method has none."""
    trace: PhysicsTrace | None
    """What the simulation did, per distinct time stamp; None without physics."""
    failures: tuple[Failure, ...]
    """Where the tracker failed grossly, and limbs that cleaning had to move far; frames
    counted by distinct time stamp."""
    notes: tuple[str, ...]
    """What the user should know about this take."""
    clips: tuple[Clip, ...]
    """What is to be written: the clip, or the parts that ``gaps`` splits it into."""

    @property
    def damage(self) -> tuple[str, ...]:
        """What was wrong with the take, when, and what was done: a sentence each."""
        time = self.clip.time
        gaps = told_gaps(long_gaps(time), time[0])
        return (*gaps, *told_failures(self.failures, time[0]))

    @property
    def share_outside(self) -> float:
        """Share of the frames whose posture the method does not know, or NaN."""
        outside = np.where(np.isnan(self.coverage), np.nan, self.coverage < 0.5)
        return float(np.mean(outside))


class Cleaner:
    """Cleans takes whole, or a live stream frame by frame, by one list of stages.

    Args:
        config: What to do; by default as learned, local PCA, then physics.
        tracking: How hard the simulated character is pulled.
        corrector: What corrects, in place of the config's method.
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
        for given, kind in ((tracking, Tracking), (corrector, Corrector)):
            check_kind(given, kind | None, f"the {kind.__name__.lower()}")
        if tracking is None:
            named = TRACKINGS[config.tracking]
            tracking = replace(named, **config.parameters.tracking)
        self.stages: tuple[Stage, ...] = (
            Upright(config),  # where the sensor was upside down, or tilted far
            Failures(),  # gross failures: sides put back, impossible limbs distrusted
            MeasureBody(config),  # how long the person's segments are
            Score(config),  # reliability of every joint
            Reconstruct(config),  # hidden limbs, from how they went and moved before
            Standardize(),  # to the standard body, root at the origin, facing +z
            Correct(config, corrector),  # what the sensor misplaces, as learned
            MeasureCorrectedBody(config),  # segments again, as corrected
            Level(config),  # standing feet, and from them the sensor's tilt
            Smooth(config),  # the slower a joint, the more
            Floor(config),  # at y = 0, under the standing feet
            Feet(config),  # stay where they stand, are lifted where they step
            Bones(),  # joints back on the person's own segments
            Orient(),  # a rotation for every segment
            Physics(config, tracking),  # a simulated character pulled through it all
        )
        left_out = {"physics": config.physics, "reconstruct": config.reconstruct}
        left_out["failures"] = config.preset is None  # no paper mends what it was given
        self.stages = tuple(s for s in self.stages if left_out.get(s.name, True))
        self._gaps = config.gaps
        self._edits = read_edits(config.edits) if config.edits else ()
        self._time: float | None = None
        self._body: Body | None = None

    def replaced(self, *stages: Stage) -> Cleaner:
        """Return a cleaner with other stages in the place of those of their names.

        Raises an InputError if there is no stage of that name.
        """
        for stage in stages:
            check_kind(stage, Stage, "a stage")
        others = {stage.name: stage for stage in stages}
        self._check_names(*others)
        return self._with([others.get(s.name, s) for s in self.stages])

    def without(self, *names: str) -> Cleaner:
        """Return a cleaner that leaves some stages out; errors as ``replaced``."""
        self._check_names(*names)
        return self._with([s for s in self.stages if s.name not in names])

    def until(self, name: str) -> Cleaner:
        """Return a cleaner that ends with a stage; errors as ``replaced``."""
        self._check_names(name)
        names = [stage.name for stage in self.stages]
        return self._with(self.stages[: names.index(name) + 1])

    def _check_names(self, *names: str) -> None:
        known = [stage.name for stage in self.stages]
        for name in names:
            check_word(name, known, "stage")

    def _with(self, stages: Sequence[Stage]) -> Cleaner:
        other = copy(self)
        other.stages, other._time, other._body = tuple(stages), None, None
        return other

    def start(self, body: Body) -> None:
        """Forget all frames: those of a body come next, one by one."""
        check_kind(body, Body, "the body")
        self._body, self._time = body, None
        for stage in self.stages:
            stage.start(body)

    def step(
        self, positions: ArrayLike, time: float, state: ArrayLike | None = None
    ) -> Draft:
        """Pass the next frame through the stages, without looking ahead.

        Args:
            positions: Joint positions [m], sensor frame with y up, NaN where missing,
                shape (J, 3).
            time: Time stamp [s], later than the last.
            state: Tracking states (State), shape (J,); by default tracked where there
                is a joint.

        Returns:
            What the stages found; ``positions`` and ``rotations`` are the character's.

        Raises:
            InputError: The frame has another shape, no numbers, or a time that does not
                go on; or nothing was started.
        """
        if self._body is None:
            raise InputError("no body to step; call start() with one")
        skeleton, time = self._body.skeleton, as_number(time, "the time of a frame")
        seen, states = checked_frame(positions, state, skeleton)
        if not abs(time) < LATEST:
            raise InputError(f"a frame at {time:g} s; give its stamp in seconds")
        if self._time is not None and time <= self._time:
            raise InputError(
                f"time {time:g} s comes after {self._time} s; give each frame the "
                "sensor's own stamp, in seconds, or call start()"
            )
        draft = Draft(skeleton, time, seen, states)
        draft.body = self._body
        if self._time is not None:
            draft.elapsed = min(time - self._time, _LONGEST_STEP)
        self._time = time
        for stage in self.stages:
            if draft.appears and not stage.goes_on:
                stage.start(self._body)
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
        """Clean a take without edits; ``clean`` can then do some of it again."""
        return unedited(self.stages, self._frames(take)[0], progress)

    def _frames(self, take: Take) -> tuple[Take, Any]:
        """Return a take's frames of distinct time stamps, and which each frame shows.

        Raises an InputError if it holds nothing to clean, or a gap that is not to be.
        """
        check_take(take)
        if self._gaps == "refuse" and (gaps := long_gaps(take.time)):
            raise InputError(
                f"{take.source}: {told_gaps(gaps, take.time[0])[0]}; clean it with "
                "--gaps hold or split, or cut it there"
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
        """Clean a take.

        Args:
            take: The take.
            edits: What somebody says of it; by default what the config's file says.
            before: The take without edits; by default it is cleaned for them.
            progress: Wraps the frame loops, for a progress bar.

        Raises an InputError if the take holds nothing to clean, or a long gap that is
        not to be, or the database does not fit, or
        the edits do not.
        """
        edits = self._edits if edits is None else tuple(edits)
        recorded, frames = self._frames(take)
        if edits:
            told = edited(recorded, edits)  # refused before any work is done
            before = before or self.unedited(take, progress)
            draft = clean_again(self.stages, told, edits, before, progress)
        else:
            draft = before.done if before else self.whole(recorded, progress)
        mended = to_world(draft.measured, draft.tilt, draft.floor)
        moved_by_correction = distances(draft.posed, mended)
        late = find_displaced(
            draft.time, mended, draft.posed, draft.heading.yaw, take.skeleton
        )
        failures = sorted((*draft.failures, *late), key=lambda found: found.first)
        del mended
        turn, tilt = draft.turn, draft.turn.tilt + draft.tilt
        raw = to_world(recorded.positions, tilt, draft.floor, turn.roll)
        motions = {"raw": raw, "corrected": draft.posed}
        force = np.full(len(recorded), np.nan)
        after = draft.posed
        if draft.trace is not None:
            motions["physics"] = after = draft.positions
            force = draft.trace.external_force
        stages = {
            name: measure(draft.time, positions, raw, draft.body, draft.stands)
            for name, positions in motions.items()
        }
        split = self._gaps == "split"
        becomes = "the next clip begins" if split else "the character holds still"
        clip = Clip(
            time=take.time,
            root=after[frames, take.skeleton.root],
            rotations=draft.rotations[frames],
            body=draft.body,
            state=take.state,
            reliability=draft.reliability[frames],
            deciding_term=draft.deciding_term[frames],
            origin=draft.origin[frames],
            moved_by_correction=moved_by_correction[frames],
            moved_by_physics=distances(after, draft.posed)[frames],
            uncertainty=uncertainty(draft)[frames],
            contacts=draft.contacts[frames],
            external_force=force[frames],
            props=tuple(prop.at(frames) for prop in draft.props),
            source=take.source,
            tilt=tilt,
            floor=draft.floor,
            roll=turn.roll,
        )
        return CleanResult(
            clip,
            draft.posed[frames],
            stages,
            draft.coverage[frames],
            draft.trace,
            tuple(failures),
            (
                *map(str, edits),
                *told_gaps(long_gaps(take.time), take.time[0], f": {becomes}"),
                *_notes(draft),
            ),
            tuple(map(clip.at, parts_of(clip.time))) if split else (clip,),
        )


def clean(
    take: Take, config: CleanConfig | None = None, *, progress: Progress = silent
) -> CleanResult:
    """Clean a take as ``Cleaner.clean``, which does many and makes its methods once."""
    return Cleaner(config).clean(take, progress=progress)


def _notes(draft: Draft) -> Iterable[str]:
    """Yield what the user should know about how a take was cleaned."""
    if not draft.reference.from_reference_posture:
        yield (
            "no T-pose or standing frames with every joint tracked: segment lengths "
            "are measured over the whole take"
        )
    yield from draft.turn.told(draft.tilt)
    if draft.turn.roll:
        yield "--tilt 0 leaves the frames of the sensor as they are"
    if draft.trace is not None and draft.trace.reset.any():
        yield f"physics: {draft.trace.status}"
