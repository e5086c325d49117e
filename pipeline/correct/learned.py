"""Correction methods that have learned from pairs of Kinect and mocap."""

from __future__ import annotations

import json
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Indices
from kinefilter.pipeline.field_types import converted, keyword_hints

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
    adjustable: ClassVar[tuple[str, ...]] = ()
    """Keywords that may differ from those it was fitted with."""
    joints_: Indices
    """The joints that it corrects, shape (M,)."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self._hold = Hold(skeleton)

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()

    @property
    def settings(self) -> dict[str, Any]:
        """The constructor's keywords; each is an attribute of the same name."""
        return {name: getattr(self, name) for name in keyword_hints(type(self))}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""
        fitted = {name: np.asarray(getattr(self, f"{name}_")) for name in self.fitted}
        if self.settings:
            fitted["settings"] = np.array(json.dumps(self.settings))
        return fitted

    def adjusted(self, **settings: Any) -> Self:
        """Return the same fitted method with other keywords.

        Raises:
            InputError: One of them decided what was learned.
        """
        for name, value in settings.items():
            own = self.settings[name]
            if name not in self.adjustable and value != own:
                raise InputError(
                    f"was trained with {name}={own}, not {value}; train again with "
                    f"'kinefilter train --set {name}={value}'"
                )
        words = np.array(json.dumps(self.settings | settings))
        return self.from_arrays(self.skeleton, {**self.arrays(), "settings": words})

    @classmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
        hints = keyword_hints(cls)
        settings = json.loads(str(arrays["settings"])) if hints else {}
        # None where a keyword may be None, and always of the type that it should have.
        known = {n: converted(settings[n], hints[n], n) for n in hints if n in settings}
        model = cls(skeleton, **known)
        for name in cls.fitted:
            setattr(model, f"{name}_", arrays[name])
        model._prepare()
        return model

    def _prepare(self) -> None:
        """Compute what follows from the fitted arrays."""
