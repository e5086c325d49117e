"""What every correction method takes and gives, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, Self, runtime_checkable

from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.training import TrainingSet

CORRECTED_TRUST = 0.9
"""Trust in a measurement that was corrected: the smoother may move it too. A guess."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One frame on the standard body, root at the origin, facing +z."""

    positions: Array
    """Joint positions [m], NaN where missing, shape (J, 3)."""
    rate: Array
    """Reliability rate in [0, 1], shape (J,)."""
    geometry: Array
    """The rate without the tracking state, shape (J,)."""
    time: float = 0.0
    """Time stamp [s]."""
    lengths: Array | None = None
    """The person's own segment lengths [m], shape (J,)."""


@dataclass(frozen=True, eq=False)
class Correction:
    """The corrected frame, in the same view and size."""

    positions: Array
    """Joint positions [m], finite, shape (J, 3)."""
    rotations: Array | None
    """Segment rotations of similar postures, wxyz, shape (J, 4), to take the twist
    from; None where the method knows none."""
    trust: Array
    """Share of the measurement in each joint, 0 where invented, shape (J,)."""
    coverage: float
    """How well the method knows the posture, in [0, 1]; NaN: it claims nothing."""


@dataclass(frozen=True, eq=False)
class ObservedTake:
    """A whole take as ``Observation`` shows its frames."""

    time: Array
    """Time stamps [s], strictly increasing, shape (T,)."""
    positions: Array
    """Joint positions [m], NaN where missing, shape (T, J, 3)."""
    rate: Array
    """Reliability rate, shape (T, J)."""


@runtime_checkable
class WholeTakeCorrector(Protocol):
    """A correction method that has to see the future: files only, no live stream."""

    def correct(self, take: ObservedTake) -> Array:
        """Return corrected joint positions [m], NaN where it has none, (T, J, 3)."""


class Corrector(Protocol):
    """A correction method; the same object serves a file and a live stream."""

    def start(self) -> None:
        """Forget all frames."""

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""


@runtime_checkable
class Mover(Protocol):
    """A correction method that does a whole take as it does its frames, but faster."""

    def move(self, positions: Array) -> Array:
        """Return joint positions [m] of a take, NaN where missing, (T, J, 3)."""


class LearnedCorrector(Corrector, Protocol):
    """A correction method that learns from pairs of Kinect and mocap.

    The constructor stores settings, ``fit`` computes, fitted state ends in ``_``.
    """

    def __init__(self, skeleton: Skeleton) -> None: ...

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn from pairs."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""

    @classmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
