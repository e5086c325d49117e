"""The interface of correction methods, for single frames and for whole takes."""

from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, check_arrays, check_kind

Frames = Iterable[int] | None
"""Yields 0 to T - 1, for example the iterator of a progress bar; None for a range."""
CORRECTED_CONFIDENCE = 0.9
"""Confidence in a corrected measurement, below 1 so that it is smoothed. A guess."""


@dataclass(frozen=True, eq=False)
class _Arrays:
    def at(self, frames: Any) -> Self:
        """Return a frame or some of a take; None makes a take of a frame."""
        rows = {
            name: np.asarray(value)[frames]
            for name, value in vars(self).items()
            if value is not None and name != "lengths"
        }
        return replace(self, **rows)


@dataclass(frozen=True, eq=False)
class Observation(_Arrays):
    """A frame on the standard body, root at the origin, facing +z.

    For a whole take, every array except ``lengths`` has a leading axis T.

    Attributes:
        positions: Joint positions [m], NaN where missing, shape (J, 3).
        reliability: Reliability in [0, 1], shape (J,).
        geometry: Reliability without the tracking state, shape (J,).
        time: Time stamp [s]; for a take strictly increasing, shape (T,).
        lengths: The person's own segment lengths [m], shape (J,).
        sensor: Position of the sensor [m] in the heading frame, shape (3,).
    """

    positions: Array
    reliability: Array
    geometry: Array
    time: Any = 0.0
    lengths: Array | None = None
    sensor: Array | None = None


@dataclass(frozen=True, eq=False)
class Correction(_Arrays):
    """A corrected frame, in the heading frame and body size of the observation.

    For a whole take, every array has a leading axis T.

    Attributes:
        positions: Joint positions [m], shape (J, 3). A method for whole takes may leave
            NaN.
        confidence: Share of the measurement in each joint, 0 without a measurement,
            shape (J,).
        coverage: How well the method knows the posture, in [0, 1]: a number, or for a
            take an array of shape (T,); NaN if the method cannot say.
    """

    positions: Array
    confidence: Array
    coverage: Any


class Corrector:
    """A correction method; the same object serves a file and a live stream."""

    def start(self) -> None:
        """Reset the state for a new motion."""

    def select_person(self, person: str | None) -> None:
        """Select a person from the training data by name; others are strangers."""

    def step(self, observation: Observation) -> Correction:  # noqa: ARG002 - refused
        """Correct the next frame; InputError if the method needs the whole take."""
        raise InputError(
            f"{type(self).__name__} needs the whole take and cannot correct it "
            "frame by frame; choose another method for live motion"
        )

    def whole(self, take: Observation, frames: Frames = None) -> Correction:
        """Correct a whole take; by default ``start``, then ``step`` for each frame."""
        self.start()
        steps = range(len(take.positions)) if frames is None else frames
        # Copies, as a method may write every frame into the same arrays.
        frames_seen = (take.at(k) for k in steps)
        found = (checked(self.step(seen), self, seen) for seen in frames_seen)
        return joined([deepcopy(one).at(None) for one in found])


def checked(
    found: Any, method: Corrector, seen: Observation, *, finite: bool = False
) -> Correction:
    """Return what a method found, or raise an InputError unless it fits what was seen.

    Positions must be ``finite``, or at least those of joints that were seen.
    """
    what, shape = f"the correction by {type(method).__name__}", seen.positions.shape
    check_kind(found, Correction, what)
    check_arrays(found, what, {"positions": shape, "coverage": shape[:-2]})
    check_arrays(found, what, {"confidence": shape[:-1]}, finite=True)
    if not np.isfinite(found.positions[finite | ~np.isnan(seen.positions)]).all():
        raise InputError(f"{what}: positions has NaN or infinite values of seen joints")
    correction: Correction = found
    return correction


def joined(parts: Sequence[Correction]) -> Correction:
    """Return consecutive parts of a take as one."""
    rows: Any = zip(*(vars(part).values() for part in parts), strict=True)
    return Correction(*map(np.concatenate, rows))


def measured_only(positions: Array) -> Correction:
    """Return positions as a correction that trusts every joint that is not NaN."""
    confidence = (~np.isnan(positions[..., 0])).astype(float)
    coverage = np.full(positions.shape[:-2], np.nan)
    return Correction(positions, confidence, coverage)


class CorrectorChain(Corrector):
    """Runs several methods one after the other, each on the result of the one before.

    Joints that were not measured stay missing for all of them. Confidence, rotations
    and coverage come from the last, whose input has at least ``least_reliability`` for
    measured joints: above 0 if the methods before already correct inferred ones.
    """

    def __init__(self, *methods: Corrector, least_reliability: float = 0.0) -> None:
        self.methods, self.least_reliability = methods, least_reliability

    def start(self) -> None:
        """Reset the state for a new motion."""
        for method in self.methods:
            method.start()

    def select_person(self, person: str | None) -> None:
        """Select a person from the training data by name; others are strangers."""
        for method in self.methods:
            method.select_person(person)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        return self._run(observation, [method.step for method in self.methods])

    def whole(self, take: Observation, frames: Frames = None) -> Correction:
        """Correct a whole take, one method after the other."""
        *before, last = (method.whole for method in self.methods)
        return self._run(take, [*before, partial(last, frames=frames)])

    def _run(
        self, seen: Observation, calls: list[Callable[[Observation], Correction]]
    ) -> Correction:
        for call, method in zip(calls[:-1], self.methods, strict=False):
            found, missing = checked(call(seen), method, seen), np.isnan(seen.positions)
            seen = replace(seen, positions=np.where(missing, np.nan, found.positions))
        least = np.where(np.isnan(seen.positions[..., 0]), 0.0, self.least_reliability)
        names = ("reliability", "geometry")
        scores = {name: np.maximum(getattr(seen, name), least) for name in names}
        seen = replace(seen, **scores)
        return checked(calls[-1](seen), self.methods[-1], seen)
