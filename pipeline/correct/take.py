"""Correct a whole take, frame by frame, on the standard body and back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Origin, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.standard import StandardTake

from .hold import Hold
from .in_turn import InTurn
from .interface import Corrector, Observation, ObservedTake, WholeTakeCorrector


@dataclass(frozen=True, eq=False)
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
    standard: StandardTake,
    corrector: Corrector | WholeTakeCorrector,
    frames: Iterable[int],
) -> CorrectedTake:
    """Correct a take.

    Args:
        standard: The take on the standard body.
        corrector: The method.
        frames: Yields 0 to T - 1, e.g. a progress bar's iterator.
    """
    seen, reliability = standard.positions, standard.reliability
    if isinstance(corrector, WholeTakeCorrector):
        observed = ObservedTake(standard.time, seen, reliability.rate)
        seen = corrector.correct(observed)
        # What it leaves open is filled as if nothing else were wrong.
        corrector = Hold(standard.body.skeleton)
    if isinstance(corrector, InTurn):
        seen, corrector = corrector.ahead(seen)
    positions, trust = np.empty_like(seen), np.empty(seen.shape[:2])
    coverage = np.empty(len(seen))
    rotations: NDArray[np.float32] | None = None
    corrector.start()
    for k in frames:
        result = corrector.step(
            Observation(
                seen[k],
                reliability.rate[k],
                reliability.geometry[k],
                float(standard.time[k]),
                standard.body.lengths,
            )
        )
        positions[k], trust[k] = result.positions, result.trust
        coverage[k] = result.coverage
        if result.rotations is not None:
            if rotations is None:
                rotations = np.empty((*seen.shape[:2], 4), dtype=np.float32)
            rotations[k] = standard.views.at(k).restore_rotations(result.rotations)
    return CorrectedTake(standard.undo(positions), rotations, trust, coverage)
