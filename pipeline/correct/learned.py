"""Correction methods that have learned from pairs of Kinect and mocap."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton

from .hold import Hold
from .interface import Corrector


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
