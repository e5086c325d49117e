"""The working state of a take, or of one frame, as it passes through the stages."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kinefilter.characters import Body, Prop, Skeleton, Take
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.gaps import parts_of
from kinefilter.retarget import HeadingFrame

from .failures import Failure
from .physics import PhysicsTrace
from .reliability import Reference
from .upright import Turn

_RECONSTRUCTED = 0.6  # weight of a hidden joint, against a measured one's 1


@dataclass(eq=False)
class Draft:
    """A take on its way to a clip, or one frame on its way to a pose.

    Shapes are those of a frame; the arrays of a take have a leading axis T. Each stage
    reads fields that earlier stages set, and sets its own, which are unset until then.
    """

    skeleton: Skeleton  # the joints, in the order of the arrays
    time: Any  # time stamps [s], strictly increasing, shape (T,); of a frame a number
    measured: Array
    """Joint positions [m], sensor frame with y up, NaN where missing, shape (J, 3);
    turned upright, with tracker failures repaired or discarded."""
    state: Codes  # tracking states (State), shape (J,), swapped where the positions are
    source: str = "take"  # where the take came from, for messages
    by_kinect: bool = True  # True if the joints come from a Kinect's tracker
    face: Array | None = None
    """Unit vectors to where the face looks, in the frame of ``positions``, NaN where
    unknown, shape (3,); None if the sensor does not see faces."""
    elapsed: float = 1.0 / 30.0  # time since the previous frame [s]; frames only

    # None without edits:
    exchanged: Flags | None = None  # whether edits swap left and right, shape ()
    distrusted: Flags | None = None  # joints that edits discard, named after that, (J,)
    failures: tuple[Failure, ...] = ()  # gross tracker failures
    reference: Reference = field(init=False)  # the person's segment lengths as measured
    body: Body = field(init=False)  # the person's body
    reliability: Array = field(init=False)  # of each joint, in [0, 1], shape (J,)
    geometry: Array = field(init=False)  # the same without the tracking state, (J,)
    deciding_term: Codes = field(init=False)  # the term that decided (Term), (J,)
    hidden: Flags | None = None  # joints in ``filled``, (J,); None without it
    filled: Array = field(init=False)  # ``measured``, reconstructed if hidden, (J, 3)
    standard: Array = field(init=False)  # joints [m] on the standard body, (J, 3)
    heading: HeadingFrame = field(init=False)  # root and heading removed from that
    positions: Array = field(init=False)
    """Joint positions [m] after the latest stage, shape (J, 3): corrected, in the
    sensor frame; from the floor stage on in the world frame with the floor at y = 0;
    after physics those of the simulated character."""
    confidence: Array = field(init=False)  # share of the measurement in joints, (J,)
    coverage: Any = field(init=False)  # of the posture, in [0, 1] or NaN, shape ()
    origin: Codes = field(init=False)  # origin of each joint (Origin), shape (J,)
    stands: Flags = field(init=False)  # which foot (left, right) is planted, (2,)
    contacts: Flags = field(init=False)  # planted parts (CONTACTS), (4,); takes only
    turn: Turn = field(default_factory=Turn)  # how the sensor frame was set upright
    roll: float = 0.0  # angle [rad] about z by which the frame was leveled after that
    tilt: float = 0.0  # angle [rad] about x, after the roll
    floor: float = 0.0  # height of the floor in the leveled sensor frame [m]
    bone_weights: Array = field(init=False)  # how firmly joints keep places, (J,)
    rotations: Array = field(init=False)  # world segment rotations, wxyz, shape (J, 4)
    posed: Array = field(init=False)  # joints [m] before physics, (J, 3); takes only
    # Frames only:
    external_force: float = float("nan")  # beyond muscles and floor [body weights]
    impossible: bool = False  # a body of impossible size or place was discarded
    appears: bool = False  # the person is seen first, or suddenly elsewhere
    reset: bool = False  # the character was reset onto its target (PhysicsTrace)
    # Takes only:
    trace: PhysicsTrace | None = None  # what the simulation did
    props: tuple[Prop, ...] = ()  # around the character in the simulation
    unedited: Unedited | None = None  # the take cleaned without edits, if any

    @classmethod
    def of(cls, take: Take) -> Draft:
        """Return the initial draft of a take."""
        fields = (take.skeleton, take.time, take.positions, take.state, take.source)
        return cls(*fields, take.by_kinect, take.face)

    def take(self) -> Take:
        """Return the measurements as a take."""
        fields = (self.time, self.measured, self.state, self.skeleton, self.source)
        return Take(*fields, by_kinect=self.by_kinect, face=self.face)

    @property
    def parts(self) -> list[Draft]:
        """The parts of a take between its long gaps, or just the draft itself."""
        spans = parts_of(self.time)
        return [self] if len(spans) == 1 else [self.part(frames) for frames in spans]

    def at(self, frames: int | slice) -> Draft:
        """Return the draft of a frame of a take, or of some, with all failures."""
        part = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(part, name, value[frames])
            elif isinstance(value, HeadingFrame):
                setattr(part, name, value.at(frames))
        return part

    def part(self, frames: slice) -> Draft:
        """Return the draft of some of a take's frames."""
        part = self.at(frames)
        inside = (f for f in self.failures if frames.start <= f.first < frames.stop)
        part.failures = tuple(failure.moved(-frames.start) for failure in inside)
        return part

    def put(self, part: Draft, frames: slice, which: Flags) -> None:
        """Copy from ``part``, which has ``frames``, those that are flagged, (T,)."""
        count, inside = len(self.time), which[frames]

        def mixed(own: Any, others: Any) -> Any:
            if isinstance(own, np.ndarray) and len(own) == count:
                own = own.copy()
                own[frames][inside] = others[inside]
            elif isinstance(own, HeadingFrame | PhysicsTrace):
                values = {k: mixed(v, getattr(others, k)) for k, v in vars(own).items()}
                own = replace(own, **values)
            return own

        for name, value in vars(part).items():
            if name in vars(self):
                setattr(self, name, mixed(getattr(self, name), value))

    def join(self, parts: Sequence[Draft]) -> None:
        """Take over the arrays and failures that a stage gave to ``parts``."""
        for name in vars(self).keys() - vars(parts[0]).keys():
            delattr(self, name)
        for name, value in vars(parts[0]).items():
            if isinstance(value, np.ndarray):
                arrays = [getattr(part, name) for part in parts]
                setattr(self, name, np.concatenate(arrays))
        first, failures = 0, list[Failure]()
        for part in parts:
            failures += [failure.moved(first) for failure in part.failures]
            first += len(part.time)
        self.failures = tuple(failures)

    @property
    def weights(self) -> Array:
        """Weight of each joint in smoothing and against other joints, (J,).

        Its confidence; a hidden limb joint, reconstructed to move like the others,
        counts nearly as much. A hand does not: it only turns with its forearm.
        """
        if self.hidden is None:
            return self.confidence
        limbs = self.hidden & ~self.skeleton.hands
        return np.maximum(self.confidence, np.where(limbs, _RECONSTRUCTED, 0.0))

    @property
    def missing(self) -> Flags:
        """Whether a joint was not measured, shape (J,)."""
        return np.asarray(np.isnan(self.measured[..., 0]))

    @property
    def completed(self) -> Array:
        """``filled``, or ``measured`` without reconstruction [m], shape (J, 3)."""
        return self.measured if self.hidden is None else self.filled


@dataclass(frozen=True, eq=False)
class Unedited:
    """A take cleaned without edits, kept for cleaning parts of it again."""

    corrected: Draft  # after correction
    planted: Draft  # after the feet were planted
    done: Draft  # after all stages
