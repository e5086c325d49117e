"""The stages of cleaning: each does one thing to a frame, or to a whole take.

``cleaner`` has their order. A stage reads what the ones before it wrote into the draft.
``step`` looks at one frame and those before it, for live motion; ``whole`` may look
ahead and does a take at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import (
    Body,
    Origin,
    Tracking,
    positions_from_rotations,
)
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous, normalize
from kinefilter.retarget import (
    BoneLengths,
    Hands,
    HeadingFrame,
    Standardizer,
    rotations_from_positions,
)

from .config import CleanConfig
from .correct import Corrector, Hold, Observation
from .correct.one_euro import OneEuro
from .draft import Draft
from .factory import make_corrector, make_scorer
from .failures import distrust, find_failures, unmirrored
from .formats.sheets import read_contacts
from .physics import PhysicsFilter
from .physics.pulled_character import PulledCharacter
from .progress import Progress
from .reliability import Reference, measure_body, measure_reference, rest_reference
from .target.feet import (
    PLANTED,
    StanceTracker,
    ankles_and_toes,
    feet_of,
    find_stance,
    flat_height,
    plant_feet,
)
from .target.floor import floor_height, leveled, place_of, put_on_floor, sensor_tilt
from .target.smooth import smooth, smooth_by_speed

_LEAST_WEIGHT = 0.1  # of an invented joint in the smoother, against a measured one's 1
_LEAST_BONE_WEIGHT = 0.3  # of an invented joint where bones ask for a move: the same
_BONES_CUTOFF = 2.0  # Hz; lengths are wrong for longer than joints tremble
_TWIST_CUTOFF = 3.0  # Hz; neighbors change from frame to frame, forearms do not
_LET_GO = 0.05  # s in which a foot that steps joins its measured path
_FLOOR_FALLS, _FLOOR_RISES = 0.2, 0.01  # share a frame: feet sink rarely, lift often
_BODY_FRAMES = 20_000  # enough for medians; an hour's take is to fit a gigabyte
_CHUNK = 4096  # frames at a time: an hour's take is to fit a gigabyte


class Stage(ABC):
    """One thing that is done to a take."""

    name: str
    """What it is called in tables, progress bars and ``Cleaner.replaced``."""
    adds: ClassVar[tuple[str, ...]] = ()
    """Fields of the draft that ``step`` sets, which ``whole`` gathers by default."""

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


class Failures(Stage):
    """Finds gross failures of the tracker and puts exchanged sides back."""

    name = "failures"

    def step(self, draft: Draft) -> None:
        """Do nothing: failures show only in what comes before and after."""

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find the failures of a take."""
        take = draft.take()
        draft.failures = find_failures(take)
        mended = unmirrored(take, draft.failures)
        draft.measured, draft.state = mended.positions, mended.state


class MeasureBody(Stage):
    """Measures the person's segments, by default on what the sensor gave."""

    name = "measure"

    def __init__(self, config: CleanConfig) -> None:
        self._height, self._mass = config.height, config.mass

    def step(self, draft: Draft) -> None:
        """Do nothing: the body of live motion is known before its first frame."""

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Measure the person of a take."""
        draft.reference = measure_reference(draft.take())
        draft.body = self._measured(draft, draft.reference)

    def _measured(self, draft: Draft, reference: Reference | None = None) -> Body:
        return measure_body(
            draft.take(), reference, height=self._height, mass=self._mass
        )


class MeasureCorrectedBody(MeasureBody):
    """Measures the segments again on what correction made of the measured joints.

    A method that knows where the sensor misplaces joints knows the person's lengths
    better than the sensor.
    """

    name = "measure again"

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Measure the person of a take."""
        some = slice(None, None, -(-len(draft.time) // _BODY_FRAMES))
        missing = draft.missing[some, :, None]
        positions = np.where(missing, np.nan, draft.positions[some])
        few = Draft(
            draft.skeleton, draft.time[some], positions, draft.state[some], draft.source
        )
        draft.body = self._measured(few)


class Score(Stage):
    """Scores how reliable every joint is."""

    name = "reliability"
    adds = ("reliability", "deciding_term", "geometry")

    def __init__(self, config: CleanConfig) -> None:
        self._scoring = config.scoring

    def start(self, body: Body) -> None:
        """Forget all frames."""
        reference = rest_reference(body)
        self._scorer = make_scorer(self._scoring, body.skeleton, reference)

    def step(self, draft: Draft) -> None:
        """Score the next frame."""
        found = self._scorer.step(draft.measured, draft.state, draft.time)
        draft.reliability, draft.deciding_term, draft.geometry = found

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Score a take, and distrust limbs where the tracker failed."""
        scorer = make_scorer(self._scoring, draft.skeleton, draft.reference)
        found = scorer.score(draft.take())
        found = distrust(found, draft.failures, draft.skeleton)
        draft.reliability, draft.geometry = found.reliability, found.geometry
        draft.deciding_term = found.term


class Standardize(Stage):
    """Brings postures to the standard body, root at the origin, facing +z."""

    name = "standardize"

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._standardizer = Standardizer(body)

    def step(self, draft: Draft) -> None:
        """Bring the next frame there."""
        draft.standard, draft.heading = self._standardizer.step(
            draft.measured, draft.reliability
        )

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Bring a take there."""
        standardizer = Standardizer(draft.body)
        draft.standard, draft.heading = standardizer.steps(
            draft.measured, draft.reliability
        )


class Correct(Stage):
    """Corrects unreliable joints by a method, and brings the postures back.

    Args:
        config: Names the method.
        corrector: The method itself, in place of the named one.
    """

    name = "correct"

    def __init__(self, config: CleanConfig, corrector: Corrector | None = None) -> None:
        self._config, self._given = config, corrector
        self._made: dict[str, Corrector] = {}

    def corrector(self, draft: Draft) -> Corrector:
        """Return the method for a draft's skeleton, made once for many takes."""
        if self._given is not None:
            return self._given
        name = draft.skeleton.name
        if name not in self._made:
            self._made[name] = make_corrector(draft.skeleton, self._config)
        return self._made[name]

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._standardizer = body, Standardizer(body)
        nobody = np.full((len(body.skeleton), 3), np.nan)
        state = np.zeros(len(body.skeleton), dtype=np.uint8)
        self._corrector = self.corrector(Draft(body.skeleton, 0.0, nobody, state))
        self._corrector.start()

    def step(self, draft: Draft) -> None:
        """Correct the next frame."""
        found = self._corrector.step(self._seen(draft, self._body))
        draft.positions = self._standardizer.undo(found.positions, draft.heading)
        draft.confidence, draft.coverage = found.confidence, found.coverage
        draft.twist = None
        if found.rotations is not None:
            draft.twist = draft.heading.restore_rotations(found.rotations)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Correct a take; what the method leaves open keeps its last bones."""
        corrector = self.corrector(draft)
        seen = self._seen(draft, draft.body)
        found = corrector.whole(seen, progress(self.name, len(draft.time)))
        del draft.standard, seen
        positions = found.positions
        if np.isnan(positions).any():
            positions = Hold(draft.skeleton).fill(positions)
        draft.positions = Standardizer(draft.body).undo(positions, draft.heading)
        draft.confidence, draft.coverage = found.confidence, found.coverage
        draft.twist = None
        if found.rotations is not None:
            draft.twist = np.empty(found.rotations.shape, dtype=np.float32)
            for k in _chunks(len(draft.time)):
                heading = draft.heading.at(k)
                draft.twist[k] = heading.restore_rotations(found.rotations[k])
        origin = np.where(found.confidence >= 1.0, Origin.MEASURED, Origin.CORRECTED)
        origin[draft.missing] = Origin.FILLED
        draft.origin = origin.astype(np.uint8)

    @staticmethod
    def _seen(draft: Draft, body: Body) -> Observation:
        return Observation(
            draft.standard, draft.reliability, draft.geometry, draft.time, body.lengths
        )


class Level(Stage):
    """Turns the sensor's frame so that the floor is level."""

    name = "level"

    def __init__(self, config: CleanConfig) -> None:
        self._tilt = None if config.tilt is None else float(np.radians(config.tilt))

    def step(self, draft: Draft) -> None:
        """Level the next frame, if the tilt is known."""
        draft.tilt = self._tilt or 0.0
        draft.positions = leveled(draft.positions, draft.tilt)

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find which feet stand, and from them the tilt, and level the take."""
        draft.stands = find_stance(
            draft.time, draft.positions, draft.confidence, draft.skeleton
        )
        draft.tilt = (
            sensor_tilt(draft.positions, draft.confidence, draft.stands, draft.body)
            if self._tilt is None
            else self._tilt
        )
        draft.positions = leveled(draft.positions, draft.tilt)


class Smooth(Stage):
    """Smooths joints, the more the slower they are; takes without any lag."""

    name = "smooth"

    def __init__(self, config: CleanConfig) -> None:
        self._cutoff = config.cutoff

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._filter = OneEuro(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Smooth the next frame."""
        if self._cutoff > 0.0:
            seen = Observation(
                draft.positions, draft.reliability, draft.geometry, draft.time
            )
            draft.positions = self._filter.step(seen).positions

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Smooth a take."""
        if self._cutoff > 0.0:
            weights = np.maximum(draft.confidence, _LEAST_WEIGHT)
            draft.positions = smooth_by_speed(
                draft.time, draft.positions, weights, cutoff=self._cutoff
            )


class Floor(Stage):
    """Puts the floor at y = 0."""

    name = "floor"

    def __init__(self, config: CleanConfig) -> None:
        self._given = config.floor_height

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._ankles, toes = ankles_and_toes(body.skeleton)
        self._flat = flat_height(body, toes[0])
        self._height = self._given

    def step(self, draft: Draft) -> None:
        """Follow the floor under the lower foot, unless it is known."""
        if self._given is None:
            sole = float(draft.positions[self._ankles, 1].min() - self._flat)
            if self._height is None:
                self._height = sole
            away = sole - self._height
            self._height += away * (_FLOOR_FALLS if away < 0.0 else _FLOOR_RISES)
        draft.floor = self._height or 0.0
        draft.positions = draft.positions - [0.0, draft.floor, 0.0]

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Find the floor under the feet of a take, unless it is known."""
        draft.floor = (
            floor_height(draft.positions, draft.confidence, draft.stands, draft.body)
            if self._given is None
            else self._given
        )
        draft.positions = draft.positions - [0.0, draft.floor, 0.0]


class Feet(Stage):
    """Keeps standing feet where they stand, and lifts them where they step.

    Args:
        config: Says when feet stand, or names a file that does.
        contacts: When they do instead (CONTACTS), shape (T, 4).
    """

    name = "feet"

    def __init__(
        self, config: CleanConfig, contacts: NDArray[np.bool_] | None = None
    ) -> None:
        self._feet, self._file, self._given = config.feet, config.contacts, contacts

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._stance = body, StanceTracker()
        self._ankles, self._toes = ankles_and_toes(body.skeleton)
        self._flat = flat_height(body, self._toes[0])
        self._moved, self._anchors = np.zeros((2, 2, 2, 3))
        self._stood = np.zeros(2, dtype=np.bool_)

    def step(self, draft: Draft) -> None:
        """Keep or lift the feet of the next frame."""
        positions, elapsed = draft.positions, draft.elapsed
        stands = self._stance.step(positions[self._ankles], float(self._flat), elapsed)
        planted, weights = positions.copy(), draft.confidence.copy()
        for foot in range(2):
            parts = [self._ankles[foot], self._toes[foot]]
            if stands[foot]:
                if not self._stood[foot]:
                    place = positions[parts] + self._moved[foot]
                    place[:, 1] = [self._flat, self._body.radii[parts[1]]]
                    self._anchors[foot] = place
                self._moved[foot] = self._anchors[foot] - positions[parts]
                weights[parts] = PLANTED
            else:
                self._moved[foot] *= np.exp(-elapsed / _LET_GO)
            planted[parts] += self._moved[foot]
        self._stood = stands.copy()
        draft.positions, draft.bone_weights = planted, weights
        draft.stands = stands.copy()

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Keep and lift the feet of a take."""
        stands, heels = draft.stands, None
        if self._feet != "auto":
            stands = np.full_like(stands, self._feet == "always")
        contacts = self._given
        if self._file is not None:
            contacts = read_contacts(self._file, draft.time)
        if contacts is not None:
            stands, heels = feet_of(contacts), contacts[:, ::2]
        draft.positions, heels = plant_feet(
            draft.time, draft.positions, draft.confidence, stands, draft.body, heels
        )
        draft.contacts = np.stack([heels, stands], axis=2).reshape(-1, 4)
        draft.stands = feet_of(draft.contacts)
        weights = np.maximum(draft.confidence, _LEAST_BONE_WEIGHT)
        for part in ankles_and_toes(draft.skeleton):
            weights[:, part] = np.where(stands, PLANTED, weights[:, part])
        draft.bone_weights = weights


class Bones(Stage):
    """Puts joints on the person's own segments, over the floor."""

    name = "bones"

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body, self._bones = body, BoneLengths(body)
        self._hands = Hands(body.skeleton)

    def step(self, draft: Draft) -> None:
        """Restore the lengths of the next frame."""
        body, positions = self._body, draft.positions
        there = self._bones.project(positions[None], draft.bone_weights[None])[0]
        there = self._hands.carried(positions, there, draft.confidence, body)
        draft.positions = put_on_floor(there[None], body)[0]

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Restore the lengths of a take, as smoothly as it was before.

        What the lengths ask for trembles with the noise of neighbors, so it is
        smoothed, and the lengths are restored once more by what little is then missing.
        """
        body, weights = draft.body, draft.bone_weights
        positions, bones = put_on_floor(draft.positions, body), BoneLengths(body)
        moved = Hands(draft.skeleton).carried(
            positions, bones.project(positions, weights), draft.confidence, body
        )
        moved -= positions
        moved = smooth(draft.time, moved, np.ones(weights.shape), cutoff=_BONES_CUTOFF)
        draft.positions = put_on_floor(bones.project(positions + moved, weights), body)


class Orient(Stage):
    """Gives every segment an orientation."""

    name = "orientation"

    def start(self, body: Body) -> None:
        """Forget all frames."""
        self._body = body

    def step(self, draft: Draft) -> None:
        """Turn the segments of the next frame."""
        draft.rotations = rotations_from_positions(
            draft.positions, self._body, draft.twist
        )

    def whole(self, draft: Draft, progress: Progress) -> None:  # noqa: ARG002
        """Turn the segments of a take, continuously over time."""
        twist = _without_jumps(draft.time, draft.twist)
        rotations = np.empty((*draft.positions.shape[:2], 4))
        for k in _chunks(len(rotations)):
            prior = None if twist is None else normalize(twist[k].astype(float))
            rotations[k] = rotations_from_positions(
                draft.positions[k], draft.body, prior
            )
        draft.rotations, draft.twist = continuous(rotations), None
        roots = draft.positions[:, draft.skeleton.root]
        draft.posed = np.empty_like(draft.positions)
        for k in _chunks(len(roots)):
            draft.posed[k] = positions_from_rotations(
                draft.rotations[k], roots[k], draft.body
            )


class Physics(Stage):
    """Pulls a simulated character through the motion by bounded forces.

    Args:
        config: Names the scene.
        tracking: How hard the character is pulled.
    """

    name = "physics"

    def __init__(self, config: CleanConfig, tracking: Tracking | None = None) -> None:
        self._scene, self._tracking = config.scene, tracking
        self._body: Body | None = None

    def start(self, body: Body) -> None:
        """Forget all frames; in a scene, the next one says where the person begins."""
        if self._body is not body:
            self._body = body
            self.character = PulledCharacter(body, self._tracking, scene=self._scene)
        self._place: HeadingFrame | None = None

    def step(self, draft: Draft) -> None:
        """Pull the character to the next frame; in a scene, in the scene's frame."""
        positions, rotations = draft.positions, draft.rotations
        first = self._place is None
        if self._place is None:
            self._place = HeadingFrame(np.zeros(3), np.zeros(()))
            if self._scene is not None:
                self._place = place_of(positions[None], draft.skeleton)
        if self._scene is not None:
            positions = self._place.remove(positions)
            rotations = self._place.remove_rotations(rotations)
        if first:
            self.character.start(positions, rotations)
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


def _without_jumps(time: Array, rotations: NDArray[Any] | None) -> NDArray[Any] | None:
    """Return rotations without the jumps between sets of neighboring postures."""
    if rotations is None:
        return None
    smoothed = np.empty_like(rotations)
    weights = np.ones((len(time), 1))
    for j in range(rotations.shape[1]):
        signed = continuous(rotations[:, j, None].astype(float))
        smoothed[:, j] = smooth(time, signed, weights, cutoff=_TWIST_CUTOFF)[:, 0]
    return smoothed


def _chunks(count: int) -> Iterator[slice]:
    return (slice(k, k + _CHUNK) for k in range(0, count, _CHUNK))
