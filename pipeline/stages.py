"""The stages of cleaning, each of which does one thing to a frame or a whole take.

``cleaner`` has their order. A stage reads from the draft what earlier stages wrote. For
live motion, ``step`` sees a frame and those before it; ``whole`` may look ahead.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from kinefilter.characters import Body, Origin, Skeleton, State, Term
from kinefilter.characters.arrays import Array, Flags
from kinefilter.retarget import BoneLengths, Standardizer

from .config import CleanConfig
from .correct import Correction, Corrector, Hold, Observation
from .correct.interface import checked
from .draft import Draft
from .factory import make_corrector
from .failures import (
    ImpossibleBodies,
    find_failures,
    lost_joints,
    repaired,
    stray_joints,
)
from .failures.limb_failures import guessed_knees
from .failures.sides import LiveSides, with_toes_ahead
from .methods import SCORERS, load
from .progress import Progress
from .reliability import (
    RecentLengths,
    UsualScores,
    measure_body,
    measure_reference,
    rest_reference,
)
from .workers import one_blas_thread

_BODY_FRAMES = 20_000  # enough for medians; an hour's take must fit into a gigabyte
CHUNK = 4096
"""Frames processed at a time, so that an hour's take fits into a gigabyte."""


class Stage(ABC):
    """One step of cleaning."""

    name: str
    """Name in tables, progress bars and ``Cleaner.replaced``."""
    adds: ClassVar[tuple[str, ...]] = ()
    """Fields of the draft that ``step`` sets, collected by the default ``whole``."""
    in_parts: ClassVar[bool] = True
    """True if each part of a take between long gaps is processed as a take of its own;
    False if the stage measures something all parts share, or handles gaps itself."""
    local = False
    """True if a few seconds of a take give the same result when processed with only
    their surroundings, so that edits need only those seconds to be cleaned again."""
    continues: ClassVar[bool] = False
    """True if the stage need not start again when the person suddenly is elsewhere."""

    def start(self, body: Body) -> None:  # noqa: B027 - some stages have no state
        """Reset the state for a new motion of a body."""

    @abstractmethod
    def step(self, draft: Draft) -> None:
        """Process the next frame."""

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Process a whole take: by default ``start``, then ``step`` for each frame."""
        self.start(draft.body)
        results: dict[str, list[Any]] = {name: [] for name in self.adds}
        for k in progress(self.name, len(draft.time)):
            frame = draft.at(k)
            self.step(frame)
            for name, values in results.items():
                values.append(getattr(frame, name))
        for name, values in results.items():
            setattr(draft, name, np.array(values))

    def run(self, draft: Draft, progress: Progress) -> None:
        """Process a whole take, split at long gaps if the stage is ``in_parts``.

        One thread: on two busy cores, two make the whole cleaning take twice as long.
        """
        with one_blas_thread():
            parts = draft.parts if self.in_parts else [draft]
            if len(parts) == 1:
                self.whole(draft, progress)
                return
            steps = iter(progress(self.name, len(draft.time)))  # one bar for all parts

            def advance(_stage: str, count: int) -> Iterator[int]:
                return (k for k, _ in zip(range(count), steps, strict=False))

            for part in parts:
                self.whole(part, advance)
            draft.join(parts)


class SharedStage(Stage):
    """A stage that people of one recording pass together, as they share the sensor."""

    in_parts = False
    shared = True
    """False if the config leaves nothing that people share."""

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Process the take of somebody who is alone."""
        self.together([draft], progress)

    @abstractmethod
    def together(self, drafts: Sequence[Draft], progress: Progress) -> None:
        """Process the takes of all people of a recording."""


class Failures(Stage):
    """Finds gross tracker failures and repairs them where possible.

    Swapped sides are swapped back; impossible bodies and limbs are discarded. Edits may
    swap sides again, and name joints to discard.
    """

    name = "failures"

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._impossible, self._sides = ImpossibleBodies(body), LiveSides(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Discard an impossible body or stray joints, and swap sides back.

        Other failures take looking ahead to find.
        """
        draft.impossible = self._impossible.step(draft.measured, draft.time)
        draft.appears = self._impossible.appears
        lost = draft.impossible | stray_joints(draft.measured, self._impossible.middle)
        if lost.any():
            draft.measured = np.where(lost[:, None], np.nan, draft.measured)
            draft.state = np.where(lost, np.uint8(State.NOT_TRACKED), draft.state)
        if self._sides.swapped(draft.measured, draft.state, float(draft.time)):
            skeleton, mirror = draft.skeleton, draft.skeleton.mirror
            behind = draft.measured[None, mirror]
            draft.measured = with_toes_ahead(behind, skeleton)[0]
            draft.state = draft.state[mirror]
            if draft.face is not None:  # nobody has one who is seen from behind
                draft.face = np.full(3, np.nan)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Find and repair the failures of a take."""
        take = draft.take()
        draft.failures = find_failures(take, draft.exchanged, draft.distrusted)
        take = repaired(take, draft.failures)
        take = take.without(guessed_knees(take))
        if draft.distrusted is not None:
            take = take.without(draft.distrusted)
        draft.measured, draft.state, draft.face = take.positions, take.state, take.face


class MeasureBody(Stage):
    """Measures the person's segments, by default in the sensor's measurements."""

    name = "measure"
    in_parts = False

    def __init__(self, config: CleanConfig) -> None:
        self._measure = partial(measure_body, height=config.height, mass=config.mass)

    def step(self, draft: Draft) -> None:
        """No-op: in live mode the body is known before the first frame."""

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Measure the person in a take."""
        if draft.unedited is not None:
            before = draft.unedited.corrected
            draft.reference, draft.body = before.reference, before.body
            return
        draft.reference = measure_reference(draft.take())
        draft.body = self._measure(draft.take(), draft.reference)


class MeasureCorrectedBody(MeasureBody):
    """Measures the segments again, on the corrected positions of measured joints.

    A method that knows where the sensor misplaces joints also knows the person's
    segment lengths better than the sensor does. The new lengths should move joints as
    little as possible, so every frame counts, not only those in a reference posture.
    """

    name = "measure again"

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Measure the person in a take."""
        if draft.unedited is not None:
            draft.body = draft.unedited.planted.body
            return
        sample = slice(None, None, -(-len(draft.time) // _BODY_FRAMES))
        positions, missing = draft.positions[sample], draft.missing[sample]
        measured = np.where(missing[..., None], np.nan, positions)
        take = replace(draft.take().at(sample), positions=measured)
        reference = measure_reference(take)
        bones = BoneLengths(self._measure(take, reference))
        lengths = bones.fitted_lengths(positions, np.where(missing, 0.0, 1.0))
        lengths = np.where(np.isnan(reference.lengths), np.nan, lengths)
        draft.body = self._measure(take, replace(reference, lengths=lengths))


class Score(Stage):
    """Scores the reliability of every joint."""

    name = "reliability"

    def __init__(self, config: CleanConfig) -> None:
        scorer = load(SCORERS[config.scoring])
        self._make_scorer = partial(scorer, **config.parameters.scorer)

    def start(self, body: Body) -> None:
        """Reset the state for a new motion of a body."""
        self._scorer = self._make_scorer(body.skeleton, rest_reference(body))
        self._recent = RecentLengths(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Score the next frame."""
        lengths = self._recent.step(draft.measured, draft.state)
        if lengths is not None:
            self._scorer.remeasure(lengths)
        scores = self._scorer.step(draft.measured, draft.state, draft.time)
        draft.reliability, draft.deciding_term, draft.geometry = scores

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Score a take."""
        scorer, take = self._make_scorer(draft.skeleton, draft.reference), draft.take()
        scores = scorer.score(take)
        draft.reliability, draft.geometry = scores.reliability, scores.geometry
        lost = lost_joints(draft.failures, take)
        draft.deciding_term = np.where(lost, np.uint8(Term.FAILURE), scores.term)


class Standardize(Stage):
    """Maps postures to the standard body, root at the origin, facing +z."""

    name = "standardize"
    in_parts = False

    def start(self, body: Body) -> None:
        """Reset the state for a new motion of a body."""
        self._standardizer = Standardizer(body)

    def step(self, draft: Draft) -> None:
        """Map the next frame."""
        joints = draft.completed, draft.reliability
        draft.standard, draft.heading = self._standardizer.step(*joints)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Map a take."""
        joints = draft.completed, draft.reliability
        draft.standard, draft.heading = Standardizer(draft.body).steps(*joints)


class Correct(Stage):
    """Corrects unreliable joints on the standard body, then maps postures back.

    The config names the method, unless a corrector is given.
    """

    name = "correct"
    local = True

    def __init__(self, config: CleanConfig, corrector: Corrector | None = None) -> None:
        self._config, self._given = config, corrector
        self._methods: dict[tuple[str, bool], Corrector] = {}

    def _method(self, skeleton: Skeleton, *, by_kinect: bool = True) -> Corrector:
        """Return the method for a skeleton, loaded once for many takes."""
        if self._given is not None:
            return self._given
        key = (skeleton.name, by_kinect)
        if key not in self._methods:
            made = make_corrector(skeleton, self._config, by_kinect=by_kinect)
            self._methods[key] = made
        return self._methods[key]

    def start(self, body: Body) -> None:
        """Reset the state for a new motion of a body."""
        self._standardizer = Standardizer(body)
        self._corrector = self._method(body.skeleton)
        self._corrector.start()
        self._usual = UsualScores(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        observation = self._observation(draft, self._usual.step)
        found = self._corrector.step(observation)
        if self._given is not None:  # kinefilter's own need no check
            found = checked(found, self._given, observation, finite=True)
        draft.positions = self._standardizer.undo(found.positions, draft.heading)
        self._record(draft, found)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take; joints the method leaves missing keep their last bones."""
        steps = progress(self.name, len(draft.time))
        observation = self._observation(draft, UsualScores(draft.skeleton).whole)
        method = self._method(draft.skeleton, by_kinect=draft.by_kinect)
        found = method.whole(observation, steps)
        if self._given is not None:
            found = checked(found, method, observation)
        del draft.standard, observation
        positions = found.positions
        if not np.isfinite(positions).all():
            positions = Hold(draft.skeleton).fill(positions)
        draft.positions = Standardizer(draft.body).undo(positions, draft.heading)
        self._record(draft, found)
        origin = np.where(draft.confidence >= 1.0, Origin.MEASURED, Origin.CORRECTED)
        origin[draft.missing] = Origin.FILLED
        draft.origin = origin.astype(np.uint8)

    @staticmethod
    def _record(draft: Draft, found: Correction) -> None:
        draft.confidence, draft.coverage = found.confidence, found.coverage
        if draft.hidden is not None:
            draft.confidence = np.where(draft.hidden, 0.0, found.confidence)

    @staticmethod
    def _observation(
        draft: Draft, usual: Callable[[Array, Flags, Flags], Array]
    ) -> Observation:
        scores = np.stack([draft.reliability, draft.geometry])
        if draft.hidden is not None:
            # What was reconstructed is corrected as if it had been measured.
            scores = usual(scores, draft.hidden, draft.state == State.TRACKED)
        context = draft.time, draft.body.lengths, draft.heading.origin
        return Observation(draft.standard, scores[0], scores[1], *context)
