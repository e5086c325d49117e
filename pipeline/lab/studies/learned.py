"""What the studies of learned methods share: what is learned, tested and counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinefilter.pipeline.correct import LearnedCorrector, TrainingSet, correct_take
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.evaluate import observed
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over
from kinefilter.pipeline.standard import StandardTake
from kinefilter.pipeline.training import training_set

from .takes import people_of, performed_by

Tested = Sequence[tuple[PairedTake, StandardTake]]
"""Takes and how the methods see them."""

GROUPS = ("new people", "known people")
"""Who is tested: people whom the method has not met, or those who taught it, in other
performances of the same motions. The papers tell of no people held back."""


@dataclass(frozen=True)
class School:
    """What methods learn from, and what they are tested on."""

    lessons: TrainingSet
    """Pairs to learn from."""
    tested: Mapping[str, Tested]
    """Takes of each of GROUPS."""

    @classmethod
    def opened(
        cls,
        motions: Sequence[str],
        *,
        learners: int,
        testers: int,
        progress: Progress,
        seed: int = 0,
        sensor: str = "v2",
    ) -> School:
        """Record everything.

        Args:
            motions: Out of MOTIONS.
            learners: People who teach.
            testers: People of each group who are tested on.
            progress: Wraps the loops, for a progress bar.
            seed: Draws people, performances and the sensor's errors.
            sensor: One of SENSORS.
        """
        first, new = people_of(seed, learners=True), people_of(seed)
        known = range(first, first + min(testers, learners))

        def record(people: range, *, again: bool = False) -> list[PairedTake]:
            return performed_by(
                people, motions, sensor=sensor, again=again, progress=progress
            )

        taught = record(range(first, first + learners))
        groups = (record(range(new, new + testers)), record(known, again=True))
        tested = {
            name: [(pair, observed(pair)) for pair in pairs]
            for name, pairs in zip(GROUPS, groups, strict=True)
        }
        return cls(training_set(over(taught, "standardize", progress)), tested)

    def errors(self, method: LearnedCorrector | None) -> tuple[float, float]:
        """Return ``mean_error`` [cm] of each group."""
        new, known = (mean_error(method, self.tested[name]) for name in GROUPS)
        return new, known


def mean_error(method: LearnedCorrector | None, tested: Tested) -> float:
    """Return the mean distance of limb joints from the truth [cm] (Liu eq. 23-25).

    Relative to the middle of the hips, on the person's own lengths. None: raw.
    """
    distances = []
    for pair, standard in tested:
        positions = pair.take.positions
        if method is not None:
            frames = range(len(positions))
            positions = correct_take(standard, method, frames).positions
        accuracy = Accuracy(pair.take.skeleton)
        distances.append(accuracy.distances(positions, pair.truth))
    return 100.0 * float(np.nanmean(np.concatenate(distances)))
