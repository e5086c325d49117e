"""What every correction method takes and gives, for a frame or for a whole take."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent

_BLOCK = 100_000  # frames looked at at a time; 200 MB of the largest skeleton

CORRECTED_TRUST = 0.9
"""Confidence in a measurement that was corrected: the smoother may move it too. A
guess."""


@dataclass(frozen=True, eq=False)
class Observation:
    """A frame on the standard body, root at the origin, facing +z.

    Of a whole take, every array but the lengths has a leading axis T.
    """

    positions: Array
    """Joint positions [m], NaN where missing, shape (J, 3)."""
    rate: Array
    """Reliability in [0, 1], shape (J,)."""
    geometry: Array
    """Reliability without the tracking state, shape (J,)."""
    time: Any = 0.0
    """Time stamp [s]: a number, or of a take strictly increasing ones, shape (T,)."""
    lengths: Array | None = None
    """The person's own segment lengths [m], shape (J,)."""

    def frame(self, k: int) -> Observation:
        """Return a frame of a take."""
        return Observation(
            self.positions[k],
            self.rate[k],
            self.geometry[k],
            float(self.time[k]),
            self.lengths,
        )


@dataclass(frozen=True, eq=False)
class Correction:
    """The corrected frame, in the same heading frame and size.

    Of a whole take, every array has a leading axis T.
    """

    positions: Array
    """Joint positions [m], shape (J, 3); NaN where a whole take's method has none."""
    rotations: Array | None
    """Segment rotations of similar postures, wxyz, shape (J, 4), to take the twist
    from; None where the method knows none."""
    trust: Array
    """Share of the measurement in each joint, 0 where invented, shape (J,)."""
    coverage: Any
    """How well the method knows the posture, in [0, 1]: a number, or of a take shape
    (T,); NaN where it makes no such claim."""


class Corrector:
    """A correction method; the same object serves a file and a live stream."""

    def start(self) -> None:
        """Forget all frames."""

    def step(self, observation: Observation) -> Correction:  # noqa: ARG002
        """Correct the next frame.

        Raises:
            InputError: The method has to see the whole take.
        """
        raise InputError(
            f"{type(self).__name__} has to see the whole take and cannot correct it "
            "frame by frame; choose another method for live motion"
        )

    def whole(
        self, take: Observation, frames: Iterable[int] | None = None
    ) -> Correction:
        """Correct a whole take: by default ``start`` and a ``step`` for each frame.

        Args:
            take: The take; every array has a leading axis T.
            frames: Yields 0 to T - 1, such as a progress bar's iterator.
        """
        count = len(take.positions)
        self.start()
        found: dict[str, Any] = {}
        for k in range(count) if frames is None else frames:
            for name, value in vars(self.step(take.frame(k))).items():
                if k == 0:
                    room = None if value is None else (count, *np.shape(value))
                    found[name] = None if room is None else np.empty(room)
                if found[name] is not None:
                    found[name][k] = value
        return Correction(**found)


def measured_only(positions: Array) -> Correction:
    """Return positions as a correction that trusts all of them, NaN where missing."""
    there = (~np.isnan(positions[..., 0])).astype(float)
    coverage = np.full(positions.shape[:-2], np.nan)
    return Correction(positions, None, there, coverage)


class InTurn(Corrector):
    """Shows each method what those before it made of the measurement.

    What was not measured stays unmeasured to all of them. Confidence, rotations and
    coverage are those of the last one.

    Args:
        methods: The methods, in their order.
        least_rate: The least reliability that a measured joint has for the last method,
            if the methods before it know what the sensor's guesses mean.
    """

    def __init__(self, *methods: Corrector, least_rate: float = 0.0) -> None:
        self.methods = methods
        self.least_rate = least_rate

    def start(self) -> None:
        """Forget all frames."""
        for method in self.methods:
            method.start()

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        *before, last = self.methods
        seen = observation
        for method in before:
            seen = self._passed_on(observation, seen, method.step(seen))
        return last.step(self._raised(seen))

    def whole(
        self, take: Observation, frames: Iterable[int] | None = None
    ) -> Correction:
        """Correct a whole take, one method after the other."""
        *before, last = self.methods
        seen = take
        for method in before:
            seen = self._passed_on(take, seen, method.whole(seen))
        return last.whole(self._raised(seen), frames)

    @staticmethod
    def _passed_on(
        measured: Observation, seen: Observation, made: Correction
    ) -> Observation:
        missing = np.isnan(measured.positions)
        return replace(seen, positions=np.where(missing, np.nan, made.positions))

    def _raised(self, seen: Observation) -> Observation:
        if self.least_rate <= 0.0:
            return seen
        least = np.where(np.isnan(seen.positions[..., 0]), 0.0, self.least_rate)
        return replace(
            seen,
            rate=np.maximum(seen.rate, least),
            geometry=np.maximum(seen.geometry, least),
        )


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Frames on the standard body, root at the origin, facing +z, and their truth."""

    positions: Array
    """Measured joint positions [m], NaN where missing, shape (N, J, 3)."""
    rate: Array
    """Reliability rate, shape (N, J)."""
    truth: Array
    """Mocap's joint positions [m] in the same view and scale, NaN where none; moved so
    that the hips' middle is where the measurement has it, shape (N, J, 3)."""
    first: NDArray[np.bool_]
    """The frame begins a take, shape (N,)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str
    """What the pairs are, for the model file."""
    lengths: Array | None = None
    """The person's own segment lengths in each frame [m], shape (N, J)."""

    def __len__(self) -> int:
        return len(self.positions)

    def blocks(self) -> Iterator[slice]:
        """Yield slices of the frames, so that a part at a time is in memory."""
        for start in range(0, len(self), _BLOCK):
            yield slice(start, min(start + _BLOCK, len(self)))


class LearnedCorrector(Corrector, ABC):
    """A correction method that learns from pairs of Kinect and mocap.

    The constructor stores settings, ``fit`` computes, fitted state ends in ``_``.
    """

    @abstractmethod
    def __init__(self, skeleton: Skeleton) -> None: ...

    @abstractmethod
    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn from pairs."""

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
