"""What every correction method takes and gives, for a frame or for a whole take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.retarget.hands import Hands

CORRECTED_CONFIDENCE = 0.9
"""Confidence in a measurement that was corrected: the smoother may move it too. A
guess."""


@dataclass(frozen=True, eq=False)
class Observation:
    """A frame on the standard body, root at the origin, facing +z.

    Of a whole take, every array but the lengths has a leading axis T.
    """

    positions: Array
    """Joint positions [m], NaN where missing, shape (J, 3)."""
    reliability: Array
    """Reliability in [0, 1], shape (J,)."""
    geometry: Array
    """Reliability without the tracking state, shape (J,)."""
    time: Any = 0.0
    """Time stamp [s]: a number, or of a take strictly increasing ones, shape (T,)."""
    lengths: Array | None = None
    """The person's own segment lengths [m], shape (J,)."""
    sensor: Array | None = None
    """Where the sensor is [m], seen from the root, the person facing +z, shape (3,)."""

    def frame(self, k: int) -> Observation:
        """Return a frame of a take."""
        return Observation(
            self.positions[k],
            self.reliability[k],
            self.geometry[k],
            float(self.time[k]),
            self.lengths,
            None if self.sensor is None else self.sensor[k],
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
    confidence: Array
    """Share of the measurement in each joint, 0 where invented, shape (J,)."""
    coverage: Any
    """How well the method knows the posture, in [0, 1]: a number, or of a take shape
    (T,); NaN where it makes no such claim."""


class Corrector:
    """A correction method; the same object serves a file and a live stream."""

    def start(self) -> None:
        """Forget all frames."""

    def know(self, person: str | None) -> None:
        """Correct a person whom the method learned from, or else a stranger."""

    def step(self, observation: Observation) -> Correction:  # noqa: ARG002 - refused
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
    """Passes what each method made of the measurement on to the next one.

    Joints that were not measured stay missing for all of them. Confidence, rotations
    and coverage are those of the last one. Where that one turns a forearm that was not
    measured, the hand turns with it.

    Args:
        methods: The methods, in their order.
        skeleton: The joints.
        least_reliability: What a measured joint has at least in the eyes of the last
            method, if those before it know what the sensor's guesses mean.
    """

    def __init__(
        self, *methods: Corrector, skeleton: Skeleton, least_reliability: float = 0.0
    ) -> None:
        self.methods = methods
        self._hands, self._body = Hands(skeleton), standard_body(skeleton)
        self.least_reliability = least_reliability

    def start(self) -> None:
        """Forget all frames."""
        for method in self.methods:
            method.start()

    def know(self, person: str | None) -> None:
        """Correct a person whom the methods learned from, or else a stranger."""
        for method in self.methods:
            method.know(person)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        seen, made = observation, None
        for method in self.methods[:-1]:
            made = method.step(seen)
            seen = self._passed_on(seen, made)
        return self._with_hands(made, self.methods[-1].step(self._raised(seen)))

    def whole(
        self, take: Observation, frames: Iterable[int] | None = None
    ) -> Correction:
        """Correct a whole take, one method after the other."""
        seen, made = take, None
        for method in self.methods[:-1]:
            made = method.whole(seen)
            seen = self._passed_on(seen, made)
        found = self.methods[-1].whole(self._raised(seen), frames)
        return self._with_hands(made, found)

    def _with_hands(self, made: Correction | None, found: Correction) -> Correction:
        if made is None or found.confidence.min() >= 1.0:
            return found
        there = self._hands.carried(
            made.positions, found.positions, found.confidence, self._body
        )
        # A hand that was measured stays, however long it is.
        stays = found.confidence[..., None] >= 1.0
        return replace(found, positions=np.where(stays, found.positions, there))

    @staticmethod
    def _passed_on(seen: Observation, made: Correction) -> Observation:
        missing = np.isnan(seen.positions)
        return replace(seen, positions=np.where(missing, np.nan, made.positions))

    def _raised(self, seen: Observation) -> Observation:
        if self.least_reliability <= 0.0:
            return seen
        least = np.where(np.isnan(seen.positions[..., 0]), 0.0, self.least_reliability)
        reliability, geometry = (
            np.maximum(r, least) for r in (seen.reliability, seen.geometry)
        )
        return replace(seen, reliability=reliability, geometry=geometry)
