"""Teaching the methods that learn."""

from __future__ import annotations

from functools import cache

from kinefilter.characters import Skeleton
from kinefilter.pipeline.correct import LearnedCorrector, TrainingSet
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.methods import LEARNED
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.training import training_set

from .simulate import simulated_pairs

_SIMULATED = 102  # people beside the recorded ones: every motion twice


def teach(
    method: str, lessons: TrainingSet, *, progress: Progress = silent
) -> LearnedCorrector:
    """Return a method that learned from pairs.

    ``learned`` learns from simulated people as well, the same ones every time.

    Raises:
        InputError: The pairs are too few.
    """
    if method == "learned":
        simulated = _simulated(lessons.skeleton)
        learned = FourierRidge(lessons.skeleton)
        return learned.fit(lessons, simulated=simulated, progress=progress)
    learner: LearnedCorrector = LEARNED[method].load()(lessons.skeleton)
    return learner.fit(lessons, progress=progress)


@cache
def _simulated(skeleton: Skeleton) -> TrainingSet | None:
    if not _SIMULATED:
        return None
    return training_set(simulated_pairs(skeleton.name, people=_SIMULATED))
