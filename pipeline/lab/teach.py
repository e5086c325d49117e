"""Training of the methods that learn from pairs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from kinefilter.characters import Skeleton
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.methods import LEARNED
from kinefilter.pipeline.progress import Progress, silent

from .methods.fourier_ridge_learner import FourierRidgeLearner
from .methods.training_data import Learner, TrainingSet
from .simulation import simulated_pairs
from .training import training_set

_SIMULATED = 102  # people besides the recorded ones: two per motion


def teach(
    method: str,
    lessons: TrainingSet,
    *,
    views: TrainingSet | None = None,
    people: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> LearnedCorrector:
    """Return a method trained on pairs.

    ``learned`` is also trained on simulated people, always the same ones, and on
    ``views``, the sessions of two sensors (see ``view_pairs``); with ``people`` it
    learns each person's own offsets too. ``settings`` are keywords of the constructors
    of the other methods.

    Raises:
        InputError: The pairs are too few.
    """
    if method == "learned":
        return FourierRidgeLearner(lessons.skeleton).fit(
            lessons,
            simulated=_simulated(lessons.skeleton),
            views=views,
            people=people,
            progress=progress,
        )
    learner: Learner = LEARNED[method].load()(lessons.skeleton, **(settings or {}))
    return learner.fit(lessons, progress=progress)


@cache
def _simulated(skeleton: Skeleton) -> TrainingSet | None:
    if not _SIMULATED:
        return None
    return training_set(simulated_pairs(skeleton.name, people=_SIMULATED))
