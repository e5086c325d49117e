"""Correction methods that were trained on pairs of Kinect and mocap."""

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
    """A method that a ``Learner`` of the lab trains; fitted state ends in ``_``."""

    fitted: ClassVar[tuple[str, ...]]
    """Names of the arrays in a model file: ``joints`` is the attribute ``joints_``."""
    adjustable: ClassVar[tuple[str, ...]] = ()
    """Keywords that can change after training."""
    joints_: Indices  # indices of the corrected joints, shape (M,)

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self._hold = Hold(skeleton)

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._hold = Hold(self.skeleton)

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
        """Return a copy with other keywords; InputError for those fixed by training."""
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
        """Return the fitted corrector from the arrays that ``arrays`` returned."""
        hints = keyword_hints(cls)
        settings = json.loads(str(arrays["settings"])) if hints else {}
        # ``converted`` gives each setting its declared type; None stays where allowed.
        known = {n: converted(settings[n], hints[n], n) for n in hints if n in settings}
        model = cls(skeleton, **known)
        for name in cls.fitted:
            setattr(model, f"{name}_", arrays[name])
        model._prepare()
        return model

    def _prepare(self) -> None:
        """Compute what follows from the fitted arrays."""
