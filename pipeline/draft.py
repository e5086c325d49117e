"""What the stages have found out about a take, or about one frame, so far."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Prop, Skeleton, Take
from kinefilter.characters.arrays import Array, Codes, Flags
from kinefilter.characters.gaps import parts_of
from kinefilter.retarget import HeadingFrame

from .failures import Failure
from .physics import PhysicsTrace
from .reliability import Reference
from .target.upright import Turn

_RECONSTRUCTED = 0.6  # weight of a hidden joint, against a measured one's 1


@dataclass(eq=False)
class Draft:
    """A take on its way to a clip, or one frame on its way to a pose.

    The arrays of a take have a leading axis T, those of a frame do not. Each stage
    reads what the stages before it found and adds its own; until then fields are unset.
    """

    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    time: Any
    """Time stamps [s], strictly increasing, shape (T,); of a frame a number."""
    measured: Array
    """Joint positions [m], sensor frame with y up, NaN where missing, shape (J, 3);
    turned upright, and without the gross failures that were mended or taken out."""
    state: Codes
    """Tracking states (State), shape (J,), exchanged as the positions are."""
    source: str = "take"
    """Where the take came from, for messages."""
    by_kinect: bool = True
    """Whether a Kinect's tracker put the joints where they are."""
    elapsed: float = 1.0 / 30.0
    """Time since the last frame [s]; frames only."""

    failures: tuple[Failure, ...] = ()
    """Where the tracker failed grossly."""
    reference: Reference = field(init=False)
    """The person's segment lengths as they were measured."""
    body: Body = field(init=False)
    """The person."""
    reliability: Array = field(init=False)
    """Reliability of each joint in [0, 1], shape (J,)."""
    geometry: Array = field(init=False)
    """Reliability without the tracking state, shape (J,)."""
    deciding_term: Codes = field(init=False)
    """The reliability term that decided (Term), shape (J,)."""
    hidden: Flags | None = None
    """Which joints the sensor did not see, or only guessed, and ``filled`` holds from
    their own motion, shape (J,); None where nobody reconstructs them."""
    filled: Array = field(init=False)
    """``measured`` with the hidden joints filled [m], shape (J, 3)."""
    standard: Array = field(init=False)
    """Joint positions [m] on the standard body, root at the origin, facing +z, NaN
    where missing, shape (J, 3)."""
    heading: HeadingFrame = field(init=False)
    """Where the standard posture's root is and which way it faces."""
    positions: Array = field(init=False)
    """Joint positions [m] as the last stage left them, shape (J, 3): corrected, in the
    sensor's frame; from the floor stage on in the world frame with the floor at 0; in
    the end those of the simulated character."""
    confidence: Array = field(init=False)
    """Share of the measurement in each joint, 0 where invented, shape (J,)."""
    coverage: Any = field(init=False)
    """How well the method knows the posture, in [0, 1] or NaN, shape ()."""
    origin: Codes = field(init=False)
    """Where each joint came from (Origin), shape (J,)."""
    twist: NDArray[Any] | None = None
    """World segment rotations of similar postures, wxyz, shape (J, 4), to take the
    twist from; None where the method knows none."""
    stands: Flags = field(init=False)
    """Whether each foot (left, right) stands, shape (2,)."""
    contacts: Flags = field(init=False)
    """Which parts of the feet stand (CONTACTS), shape (4,); takes only."""
    turn: Turn = field(default_factory=Turn)
    """How the sensor's frame was turned upright, ``measured`` with it."""
    tilt: float = 0.0
    """Angle [rad] about x by which the frame was leveled after that."""
    floor: float = 0.0
    """Height of the floor in the leveled sensor's frame [m]."""
    bone_weights: Array = field(init=False)
    """How firmly each joint stays where it is when bone lengths are restored, (J,)."""
    rotations: Array = field(init=False)
    """World segment rotations, wxyz, shape (J, 4)."""
    posed: Array = field(init=False)
    """Joint positions [m] of the body before physics, shape (J, 3); takes only."""
    external_force: Any = float("nan")
    """Force on the body that no muscle and no floor gives [body weights], shape ()."""
    impossible: bool = False
    """The body was of a size or at a place that nobody gets to, and was taken out;
    frames only."""
    appears: bool = False
    """The person is seen for the first time, or suddenly elsewhere; frames only."""
    reset: bool = False
    """The character was put back onto its target, as in PhysicsTrace; frames only."""
    trace: PhysicsTrace | None = None
    """What the simulation did; takes only."""
    props: tuple[Prop, ...] = ()
    """What was around the character in the simulation; takes only."""
    unedited: Unedited | None = None
    """The same take as it was cleaned without edits: body, tilt and floor are measured
    there; None unless the take is edited."""

    @classmethod
    def of(cls, take: Take) -> Draft:
        """Return the draft of a take about which nothing was found out yet."""
        known = (take.skeleton, take.time, take.positions, take.state, take.source)
        return cls(*known, take.by_kinect)

    @property
    def parts(self) -> list[Draft]:
        """The parts of a take between its long gaps: the draft itself without one."""
        spans = parts_of(self.time)
        return [self] if len(spans) == 1 else [self.part(frames) for frames in spans]

    def part(self, frames: slice) -> Draft:
        """Return the draft of some of the frames of a take."""
        part = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(part, name, value[frames])
            elif isinstance(value, HeadingFrame):
                setattr(part, name, value.at(frames))
        part.failures = tuple(
            found.moved(-frames.start)
            for found in self.failures
            if frames.start <= found.first < frames.stop
        )
        return part

    def put(self, part: Draft, frames: slice, which: Flags) -> None:
        """Take over what ``part`` has of some of its ``frames``, flags (T,)."""
        count, inside = len(self.time), which[frames]

        def mixed(own: Any, others: Any) -> Any:
            if isinstance(own, np.ndarray) and len(own) == count:
                own = own.copy()
                own[frames][inside] = others[inside]
            elif isinstance(own, HeadingFrame | PhysicsTrace):
                values = {
                    name: mixed(value, getattr(others, name))
                    for name, value in vars(own).items()
                }
                own = replace(own, **values)
            return own

        for name, value in vars(part).items():
            if name in vars(self):
                setattr(self, name, mixed(getattr(self, name), value))

    def join(self, parts: Sequence[Draft]) -> None:
        """Take over the arrays and failures that a stage gave to ``parts``."""
        known, first, failures = vars(parts[0]), 0, list[Failure]()
        for name in vars(self).keys() - known.keys():
            delattr(self, name)
        for name in known:
            values = [getattr(part, name) for part in parts]
            if isinstance(values[0], np.ndarray):
                setattr(self, name, np.concatenate(values))
        for part in parts:
            failures += [found.moved(first) for found in part.failures]
            first += len(part.time)
        self.failures = tuple(failures)

    @property
    def weights(self) -> Array:
        """How much each joint counts in smoothing and against others, (J,).

        Its confidence; a hidden one, which is reconstructed to move like the others,
        counts nearly as much. A hand does not: it only turns with its forearm.
        """
        if self.hidden is None:
            return self.confidence
        limbs = self.hidden & ~self.skeleton.hands
        least = np.where(limbs, _RECONSTRUCTED, 0.0)
        return np.maximum(self.confidence, least)

    @property
    def missing(self) -> Flags:
        """Whether a joint was not measured, shape (J,)."""
        return np.asarray(np.isnan(self.measured[..., 0]))

    def take(self) -> Take:
        """Return the draft's take."""
        known = (self.time, self.measured, self.state, self.skeleton, self.source)
        return Take(*known, by_kinect=self.by_kinect)


@dataclass(frozen=True, eq=False)
class Unedited:
    """A take that was cleaned without edits, for cleaning some of it again."""

    corrected: Draft
    """After correction."""
    planted: Draft
    """After feet were planted."""
    done: Draft
    """After all stages."""
