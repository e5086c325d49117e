"""Training sets: pairs of Kinect and mocap on the standard body; and what learns."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.methods import LEARNED
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget import Standardizer

from .methods.fourier_ridge_learner import FourierRidgeLearner
from .methods.training_data import Learner, TrainingSet
from .simulation import simulated_pairs
from .spool import Spool

_SIMULATED = 102  # people besides the recorded ones: two per motion


def training_set(
    pairs: Iterable[PairedTake], config: CleanConfig | None = None
) -> TrainingSet:
    """Transfer pairs to the standard body, as a corrector will receive them.

    The frames are stored on disk, so they may be larger than memory. They are scored as
    in ``config``, by default as ``clean`` does. Raises an InputError if there are no
    pairs, or if their skeletons differ.
    """
    skeleton: Skeleton | None = None
    spools: dict[str, Spool] = defaultdict(lambda: Spool(np.float64))
    counts: list[int] = []
    subjects: dict[str, int] = {}
    people: list[int] = []
    for pair in pairs:
        skeleton = skeleton or pair.take.skeleton
        if pair.take.skeleton != skeleton:
            raise InputError(
                f"{pair.take.source}: the skeleton is {pair.take.skeleton.name}, but "
                f"that of the first pairs is {skeleton.name}; train one model per "
                "skeleton"
            )
        draft = observed(pair, config)
        spools["positions"].add(draft.standard)
        spools["reliability"].add(draft.reliability)
        spools["truth"].add(standard_truth(pair, draft))
        spools["lengths"].add(np.tile(draft.body.lengths, (len(pair.take), 1)))
        spools["time"].add(draft.time)
        spools["sensor"].add(draft.heading.origin)
        counts.append(len(pair.take))
        people.append(subjects.setdefault(pair.subject, len(subjects)))
    if skeleton is None:
        raise InputError("no clips to learn from; give pairs files with clips in them")
    first = np.concatenate([np.arange(count) == 0 for count in counts])
    names = sorted(subjects) if len(subjects) <= 20 else [f"{len(subjects)} people"]
    return TrainingSet(
        **{name: spool.array() for name, spool in spools.items()},
        first=first,
        skeleton=skeleton,
        source=f"{counted(len(counts), 'clip')} of {', '.join(names)}",
        person=np.repeat(people, counts),
        people=tuple(subjects),
    )


def observed(pair: PairedTake, config: CleanConfig | None = None) -> Draft:
    """Return a take as correction receives it, but with tracking failures."""
    cleaner = Cleaner(config)
    if config is None or config.preset is None:  # a preset has no such stage
        cleaner = cleaner.without("failures")
    return cleaner.until("standardize").whole(pair.take)


def standard_truth(pair: PairedTake, draft: Draft) -> Array:
    """Return a pair's mocap as in its draft, hips in the same place [m], (T, J, 3)."""
    hips, measured = draft.skeleton.hips, draft.measured
    shift = measured[:, hips].mean(axis=1) - pair.truth[:, hips].mean(axis=1)
    truth = pair.truth + shift[:, None]
    filled = np.where(np.isnan(truth), measured, truth)
    standard = Standardizer(draft.body).standardize(filled, draft.heading)
    return np.where(np.isnan(truth), np.nan, standard)


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
    of the other methods. Raises an InputError if the pairs are too few.
    """
    if method == "learned":
        simulated = _simulated(lessons.skeleton, _SIMULATED)
        return FourierRidgeLearner(lessons.skeleton).fit(
            lessons, simulated=simulated, views=views, people=people, progress=progress
        )
    learner: Learner = LEARNED[method].load()(lessons.skeleton, **(settings or {}))
    return learner.fit(lessons, progress=progress)


@cache
def _simulated(skeleton: Skeleton, people: int) -> TrainingSet | None:
    pairs = simulated_pairs(skeleton.name, people=people)
    return training_set(pairs) if pairs else None
