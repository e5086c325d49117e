"""What the methods that learn from pairs of Kinect and mocap share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array

from .hold import Hold
from .interface import Corrector


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Frames on the standard body, root at the origin, facing +z, and their truth."""

    positions: Array
    """Measured joint positions [m], NaN where missing, shape (N, J, 3)."""
    reliability: Array
    """Reliability in [0, 1], shape (N, J)."""
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
    person: NDArray[np.intp] | None = None
    """Whose frame it is, by number, shape (N,)."""
    people: tuple[str, ...] = ()
    """Their names, by number."""
    time: Array | None = None
    """Time stamps [s] within each take, shape (N,); None: 30 frames a second."""
    sensor: Array | None = None
    """Where the sensor is, as in ``Observation``, shape (N, 3)."""

    def __len__(self) -> int:
        return len(self.positions)


class LearnedCorrector(Corrector):
    """A correction method that learns from pairs of Kinect and mocap.

    Fitted state ends in ``_``; ``Learner`` in the lab's methods computes it.

    Args:
        skeleton: The joints.
    """

    fitted: ClassVar[tuple[str, ...]]
    """Names of the arrays in a model file: ``joints`` is the attribute ``joints_``."""
    joints_: NDArray[np.intp]
    """The joints that it corrects, shape (M,)."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self._hold = Hold(skeleton)

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""
        return {name: np.asarray(getattr(self, f"{name}_")) for name in self.fitted}

    @classmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
        model = cls(skeleton, **cls._settings(arrays))
        for name in cls.fitted:
            setattr(model, f"{name}_", arrays[name])
        model._prepare()
        return model

    @classmethod
    def _settings(cls, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:  # noqa: ARG003 - none
        """Return the constructor's arguments that a model file holds."""
        return {}

    def _prepare(self) -> None:
        """Compute what follows from the fitted arrays."""
