"""Correct a whole take, frame by frame, on the standard body and back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Origin, Take
from kinefilter.pipeline.reliability import Reliability
from kinefilter.retarget import Standardizer

from .interface import Corrector, Observation

__all__ = ["CorrectedTake", "correct_take"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CorrectedTake:
    """A corrected take, on the person's body in the sensor's frame."""

    positions: Array
    """Joint positions [m], finite, shape (T, J, 3)."""
    rotations: NDArray[np.float32] | None
    """World segment rotations of similar postures, wxyz, shape (T, J, 4), to take the
    twist from; None where the method knows none."""
    trust: Array
    """Share of the measurement in each joint, 0 where invented, shape (T, J)."""
    coverage: Array
    """How well the method knows each posture, in [0, 1] or NaN, shape (T,)."""

    def origin(self, take: Take) -> NDArray[np.uint8]:
        """Return where each joint came from (Origin), shape (T, J)."""
        origin = np.where(self.trust >= 1.0, Origin.MEASURED, Origin.CORRECTED)
        missing = np.isnan(take.positions[..., 0])
        return np.where(missing, Origin.FILLED, origin).astype(np.uint8)


def correct_take(
    take: Take,
    body: Body,
    reliability: Reliability,
    corrector: Corrector,
    frames: Iterable[int],
) -> CorrectedTake:
    """Correct a take.

    Args:
        take: The recording.
        body: The person.
        reliability: Of every joint and frame of the take.
        corrector: The method.
        frames: Yields 0 to T - 1, e.g. a progress bar's iterator.
    """
    count, joints = take.state.shape
    positions, trust = np.empty((count, joints, 3)), np.empty((count, joints))
    coverage = np.empty(count)
    rotations: NDArray[np.float32] | None = None
    standardizer = Standardizer(body)
    corrector.start()
    for k in frames:
        rate = reliability.rate[k]
        standard, view = standardizer.step(take.positions[k], rate)
        geometry, time = reliability.geometry[k], float(take.time[k])
        result = corrector.step(Observation(standard, rate, geometry, time))
        positions[k] = standardizer.undo(result.positions, view)
        trust[k], coverage[k] = result.trust, result.coverage
        if result.rotations is not None:
            if rotations is None:
                rotations = np.empty((count, joints, 4), dtype=np.float32)
            rotations[k] = view.restore_rotations(result.rotations)
    return CorrectedTake(positions, rotations, trust, coverage)
