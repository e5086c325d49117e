"""The stages of cleaning: each does one thing to a frame, or to a whole take.

``cleaner`` has their order. A stage reads what the ones before it wrote into the draft.
``step`` looks at one frame and those before it, for live motion; ``whole`` may look
ahead and does a take at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from kinefilter.characters import Body, Origin, Skeleton, Tracking
from kinefilter.characters.arrays import Array, chunks
from kinefilter.retarget import BoneLengths, HeadingFrame, Standardizer

from .config import CleanConfig
from .correct import Correction, Corrector, Hold, Observation
from .draft import Draft
from .factory import make_corrector
from .failures import (
    ImpossibleBodies,
    distrust,
    find_failures,
    unmirrored,
    without_nobody,
)
from .methods import SCORERS, load
from .physics import PhysicsFilter
from .physics.pulled_character import PulledCharacter
from .progress import Progress
from .reliability import measure_body, measure_reference, rest_reference
from .target.floor import place_of

_BODY_FRAMES = 20_000  # enough for medians; an hour's take is to fit a gigabyte
CHUNK = 4096
"""Frames at a time: an hour's take is to fit a gigabyte."""


class Stage(ABC):
    """One thing that is done to a take."""

    name: str
    """What it is called in tables, progress bars and ``Cleaner.replaced``."""
    adds: ClassVar[tuple[str, ...]] = ()
    """Fields of the draft that ``step`` sets, which ``whole`` gathers by default."""
    in_parts: ClassVar[bool] = True
    """Whether it does each part between long gaps as a take of its own; otherwise it
    measures what is the same in all of them, or minds the gaps itself."""

    local = False
    """Whether some seconds of a take come out the same where only they and those about
    them are given, so that the edited ones alone are done again."""

    goes_on: ClassVar[bool] = False
    """Whether its steps go on where the person is suddenly elsewhere; others begin
    anew."""

    def start(self, body: Body) -> None:  # noqa: B027 - most have something to forget
        """Forget all frames; those of a body come next."""

    @abstractmethod
    def step(self, draft: Draft) -> None:
        """Do the next frame."""

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Do a whole take: by default ``start`` and a ``step`` for each frame."""
        self.start(draft.body)
        count, found = len(draft.time), dict[str, list[Any]]()
        arrays = {
            name: value
            for name, value in vars(draft).items()
            if isinstance(value, np.ndarray) and len(value) == count
        }
        for k in progress(self.name, count):
            frame = Draft(
                draft.skeleton, draft.time[k], draft.measured[k], draft.state[k]
            )
            for name, array in arrays.items():
                setattr(frame, name, array[k])
            self.step(frame)
            for name in self.adds:
                found.setdefault(name, []).append(getattr(frame, name))
        for name, values in found.items():
            setattr(draft, name, np.array(values))

    def run(self, draft: Draft, progress: Progress) -> None:
        """Do a whole take, in its parts between long gaps where it is ``in_parts``."""
        parts = draft.parts if self.in_parts else [draft]
        if len(parts) == 1:
            self.whole(draft, progress)
            return
        steps = iter(progress(self.name, len(draft.time)))  # one bar for all
        for part in parts:
            self.whole(part, partial(_drawn, steps))
        draft.join(parts)


class Failures(Stage):
    """Finds gross failures of the tracker, and mends what it can.

    Exchanged sides are put back; frames in which nobody can be so are taken out.
    """

    name = "failures"

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._impossible = ImpossibleBodies(body)

    def step(self, draft: Draft) -> None:
        """Take out the next frame if nobody can be so; all else shows only later."""
        draft.impossible = self._impossible.step(draft.measured, draft.time)
        draft.appears = self._impossible.appears
        if draft.impossible:
            draft.measured = np.full_like(draft.measured, np.nan)
            draft.state = np.zeros_like(draft.state)

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find the failures of a take."""
        take = draft.take()
        draft.failures = find_failures(take)
        mended = unmirrored(without_nobody(take, draft.failures), draft.failures)
        draft.measured, draft.state = mended.positions, mended.state


class MeasureBody(Stage):
    """Measures the person's segments, by default on what the sensor gave."""

    name = "measure"
    in_parts = False

    def __init__(self, config: CleanConfig) -> None:
        self._measured = partial(measure_body, height=config.height, mass=config.mass)

    def step(self, draft: Draft) -> None:
        """Do nothing: the body of live motion is known before its first frame."""

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Measure the person of a take."""
        if draft.unedited is not None:
            before = draft.unedited.corrected
            draft.reference, draft.body = before.reference, before.body
            return
        draft.reference = measure_reference(draft.take())
        draft.body = self._measured(draft.take(), draft.reference)


class MeasureCorrectedBody(MeasureBody):
    """Measures the segments again on what correction made of the measured joints.

    A method that knows where the sensor misplaces joints knows the person's lengths
    better than the sensor. Joints are to move little for the sake of these lengths, so
    that all frames count, not only those in which the person stands.
    """

    name = "measure again"

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Measure the person of a take."""
        if draft.unedited is not None:
            draft.body = draft.unedited.planted.body
            return
        some = slice(None, None, -(-len(draft.time) // _BODY_FRAMES))
        missing = draft.missing[some, :, None]
        positions = np.where(missing, np.nan, draft.positions[some])
        few = replace(draft.take().at(some), positions=positions)
        reference = measure_reference(few)
        bones = BoneLengths(self._measured(few, reference))
        lengths = bones.fitting(
            draft.positions[some], np.where(missing[..., 0], 0.0, 1.0)
        )
        lengths = np.where(np.isnan(reference.lengths), np.nan, lengths)
        draft.body = self._measured(few, replace(reference, lengths=lengths))


class Score(Stage):
    """Scores how reliable every joint is."""

    name = "reliability"
    adds = ("reliability", "deciding_term", "geometry")

    def __init__(self, config: CleanConfig) -> None:
        scorer = load(SCORERS[config.scoring])
        self._made = partial(scorer, **config.parameters.scorer)

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._scorer = self._made(body.skeleton, rest_reference(body))

    def step(self, draft: Draft) -> None:
        """Score the next frame."""
        found = self._scorer.step(draft.measured, draft.state, draft.time)
        draft.reliability, draft.deciding_term, draft.geometry = found

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Score a take, and distrust limbs where the tracker failed."""
        found = self._made(draft.skeleton, draft.reference).score(draft.take())
        found = distrust(found, draft.failures, draft.skeleton)
        draft.reliability, draft.geometry = found.reliability, found.geometry
        draft.deciding_term = found.term


class Standardize(Stage):
    """Brings postures to the standard body, root at the origin, facing +z."""

    name = "standardize"
    in_parts = False

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._standardizer = Standardizer(body)

    def step(self, draft: Draft) -> None:
        """Bring the next frame there."""
        draft.standard, draft.heading = self._standardizer.step(*_known(draft))

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Bring a take there."""
        standardizer = Standardizer(draft.body)
        draft.standard, draft.heading = standardizer.steps(*_known(draft))


class Correct(Stage):
    """Corrects unreliable joints by the method that the config names, or a given one.

    Then it brings the postures back.
    """

    name = "correct"
    local = True

    def __init__(self, config: CleanConfig, corrector: Corrector | None = None) -> None:
        self._config, self._given = config, corrector
        self._made: dict[tuple[str, bool], Corrector] = {}

    def _method(self, skeleton: Skeleton, *, by_kinect: bool = True) -> Corrector:
        """Return the method for a skeleton, made once for many takes."""
        if self._given is not None:
            return self._given
        key = (skeleton.name, by_kinect)
        if key not in self._made:
            self._made[key] = make_corrector(
                skeleton, self._config, by_kinect=by_kinect
            )
        return self._made[key]

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._standardizer = body, Standardizer(body)
        self._corrector = self._method(body.skeleton)
        self._corrector.start()

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        found = self._corrector.step(self._seen(draft, self._body))
        draft.positions = self._standardizer.undo(found.positions, draft.heading)
        self._note(draft, found)
        if found.rotations is not None:
            draft.twist = draft.heading.restore_rotations(found.rotations)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take; what the method leaves open keeps its last bones."""
        steps = progress(self.name, len(draft.time))
        seen = self._seen(draft, draft.body)
        method = self._method(draft.skeleton, by_kinect=draft.by_kinect)
        found = method.whole(seen, steps)
        del draft.standard, seen
        positions = found.positions
        if np.isnan(positions).any():
            positions = Hold(draft.skeleton).fill(positions)
        draft.positions = Standardizer(draft.body).undo(positions, draft.heading)
        self._note(draft, found)
        if found.rotations is not None:
            draft.twist = np.empty(found.rotations.shape, dtype=np.float32)
            for k in chunks(len(draft.time), CHUNK):
                heading = draft.heading.at(k)
                draft.twist[k] = heading.restore_rotations(found.rotations[k])
        origin = np.where(draft.confidence >= 1.0, Origin.MEASURED, Origin.CORRECTED)
        origin[draft.missing] = Origin.FILLED
        draft.origin = origin.astype(np.uint8)

    @staticmethod
    def _note(draft: Draft, found: Correction) -> None:
        draft.confidence, draft.coverage = found.confidence, found.coverage
        if draft.hidden is not None:
            draft.confidence = np.where(draft.hidden, 0.0, found.confidence)
        draft.twist = None

    @staticmethod
    def _seen(draft: Draft, body: Body) -> Observation:
        reliability, geometry = draft.reliability, draft.geometry
        if draft.hidden is not None:
            # What was reconstructed is the method's to correct, not to replace.
            reliability = np.where(draft.hidden, 1.0, reliability)
            geometry = np.where(draft.hidden, 1.0, geometry)
        return Observation(
            draft.standard,
            reliability,
            geometry,
            draft.time,
            body.lengths,
            draft.heading.origin,
        )


class Physics(Stage):
    """Pulls a simulated character through the motion by bounded forces."""

    name = "physics"
    goes_on = True
    in_parts = False

    def __init__(self, config: CleanConfig, tracking: Tracking | None = None) -> None:
        self._scene, self._tracking = config.scene, tracking
        self.local = config.scene is None  # things stay where they were put
        self._body: Body | None = None
        self._place: HeadingFrame

    def start(self, body: Body) -> None:
        """Forget all frames; in a scene, the next one says where the person begins."""
        if self._body is not body:
            self._body = body
            self.character = PulledCharacter(body, self._tracking, scene=self._scene)
        self._begun = False

    def step(self, draft: Draft) -> None:
        """Pull the character to the next frame; in a scene, in the scene's frame."""
        positions, rotations = draft.positions, draft.rotations
        first, self._begun = not self._begun, True
        if self._scene is not None:
            if first:
                self._place = place_of(positions[None], draft.skeleton)
            positions = self._place.remove(positions)
            rotations = self._place.remove_rotations(rotations)
        if first or draft.appears:
            # Things around it stay where they are, but for the first frame.
            self.character.start(positions, rotations, anew=first)
        else:
            draft.reset = not self.character.step(
                positions, rotations, draft.elapsed, stands=draft.stands
            )
        draft.positions = self.character.positions
        draft.rotations = self.character.rotations
        draft.external_force = self.character.external_force

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Pull the character through a take."""
        character = PhysicsFilter(draft.body, self._tracking, scene=self._scene)
        positions, rotations, place = draft.positions, draft.rotations, None
        if self._scene is not None:
            place = place_of(positions, draft.skeleton)
            positions = place.remove(positions)
            rotations = place.remove_rotations(rotations)
        result = character.run(
            draft.time,
            positions,
            rotations,
            stands=draft.stands,
            frames=progress(self.name, len(draft.time)),
        )
        draft.positions, draft.rotations = result.positions, result.rotations
        if place is not None:
            draft.positions = place.restore(result.positions)
            draft.rotations = place.restore_rotations(result.rotations)
            draft.props = result.things.props(place)
        draft.trace = result.trace
        draft.external_force = result.trace.external_force


def _drawn(steps: Iterator[int], _stage: str, count: int) -> Iterator[int]:
    """Yield the steps of a part, one for each that is drawn from those of all parts."""
    return (k for k, _ in zip(range(count), steps, strict=False))


def _known(draft: Draft) -> tuple[Array, Array]:
    """Return the positions [m] of a draft's joints, and what they are worth."""
    seen = draft.measured if draft.hidden is None else draft.filled
    return seen, draft.reliability
