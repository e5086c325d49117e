"""The cleaner: the list of stages that every take and every live frame passes through.

This is the only place that knows their order. ``clean`` runs the list over a whole
take; ``Avatar`` and ``live`` step through it frame by frame; ``bench`` times its
entries; ``evaluate`` replaces one of them and measures the final result.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import TRACKINGS, Body, InputError, Take, Tracking
from kinefilter.characters.arrays import as_number, check_choice, check_kind
from kinefilter.characters.gaps import describe_gaps, long_gaps
from kinefilter.characters.motion import LATEST_TIME_STAMP, distinct_stamps

from .checks import checked_frame, checked_take
from .clean_result import CleanResult, result_of
from .config import CleanConfig
from .correct import Corrector
from .draft import Draft, Unedited
from .editing import clean_again, unedited
from .edits import Edit, check_edits, read_edits
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
from .target.aim_stages import AimHands, AimHead, Orient
from .target.frame_stages import Floor, Level, Upright
from .target.target_stages import Bones, Feet, Ranges, Smooth

_Passing = tuple[Take, Any, Draft]  # recorded frames, index of all, working state
_LONGEST_STEP = 0.5  # s; a longer pause in the stream counts as this much motion


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
            Ranges(),  # keep trunks, arms and knees from where nobody has them
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
        # No paper repairs its input or output.
        enabled |= dict.fromkeys(("failures", "ranges"), config.preset is None)
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
        for stage in self.stages:
            stage.run(draft, silent)
            if stage.name in (MeasureBody.name, MeasureCorrectedBody.name):
                bodies.append(draft.body)
            if stage.name == MeasureCorrectedBody.name:
                break
        return bodies[-1], bodies[0]

    def start(self, body: Body, measured: Body | None = None) -> None:
        """Reset the state for a new motion of a body, to be passed to ``step``.

        ``measured`` has the person's segment lengths as the sensor shows them, which
        correction needs; by default they are those of ``body``.
        """
        check_kind(body, Body, "the body")
        check_kind(measured, Body | None, "the measured body")
        if measured is not None and measured.skeleton != body.skeleton:
            raise InputError(
                f"the body has the joints of {body.skeleton.name}, and the measured "
                f"body those of {measured.skeleton.name}; give two of one skeleton"
            )
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
        self.go_on(draft)
        return draft

    def go_on(self, draft: Draft) -> None:
        """Pass a frame from earlier stages through these; call ``start`` first."""
        for stage, draft.body in zip(self.stages, self._bodies, strict=True):
            if draft.appears and not stage.continues:
                stage.start(draft.body)
            stage.step(draft)

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
        take = checked_take(take)
        if self._gaps == "refuse" and (gaps := long_gaps(take.time)):
            raise InputError(
                f"{take.source}: {describe_gaps(gaps, take.time[0])[0]}; clean it with "
                "--gaps hold or split, or cut the take there"
            )
        distinct = distinct_stamps(take.time)
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
        one, split = (recorded, frames, draft), self._gaps == "split"
        return result_of(take, *one, edits, split=split)

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
                yield result_of(take, *one, (), split=self._gaps == "split")

    def _started(self, take: Take) -> _Passing | InputError:
        try:
            recorded, frames = self._distinct(take)
        except InputError as error:
            return error
        return recorded, frames, Draft.of(recorded)


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
    """Clean one take, by default with the settings of ``CleanConfig()``.

    Fields of the config are options that ``kinefilter clean --help`` explains.
    ``progress`` wraps the frame loops. Raises an InputError if there is nothing to
    clean, or the settings do not fit the take. A ``Cleaner`` loads its methods once for
    many takes.
    """
    return Cleaner(config).clean(take, progress=progress)
