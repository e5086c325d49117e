"""Pairs of Kinect and mocap, brought to the standard body to learn from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.retarget import Standardizer

from .methods.lessons import TrainingSet
from .spool import Spool


def training_set(
    pairs: Iterable[PairedTake], config: CleanConfig | None = None
) -> TrainingSet:
    """Bring pairs to the standard body, as a corrector will see them.

    The frames are put aside on a disk, so that there may be more than memory holds.
    The config says how they are scored; by default as ``clean`` does.

    Raises:
        InputError: No pairs, or pairs of different skeletons.
    """
    skeleton: Skeleton | None = None
    parts = [Spool(np.float64) for _ in range(6)]
    counts: list[int] = []
    subjects: dict[str, int] = {}
    people: list[int] = []
    for pair in pairs:
        skeleton = skeleton or pair.take.skeleton
        if pair.take.skeleton != skeleton:
            raise InputError(
                f"{pair.take.source}: {pair.take.skeleton.name}, but the first pairs "
                f"are {skeleton.name}; train one model a skeleton"
            )
        for part, rows in zip(parts, _standardized(pair, config), strict=True):
            part.add(rows)
        counts.append(len(pair.take))
        people.append(subjects.setdefault(pair.subject, len(subjects)))
    if skeleton is None:
        raise InputError("no clips to learn from; give pairs files with clips in them")
    first = np.zeros(sum(counts), dtype=bool)
    first[np.concatenate([[0], np.cumsum(counts)[:-1]])] = True
    names = sorted(subjects) if len(subjects) <= 20 else [f"{len(subjects)} people"]
    positions, reliability, truth, lengths, time, sensor = (p.array() for p in parts)
    return TrainingSet(
        positions,
        reliability,
        truth,
        first,
        skeleton,
        f"{len(counts)} clips of {', '.join(names)}",
        lengths,
        np.repeat(people, counts),
        tuple(subjects),
        time,
        sensor,
    )


def observed(pair: PairedTake, config: CleanConfig | None = None) -> Draft:
    """Return what correction sees of a take, scored and on the standard body.

    Failures stay in: what is to be learned or compared is what the sensor gave.
    """
    cleaner = Cleaner(config)
    if config is None or config.preset is None:  # a preset has no such stage
        cleaner = cleaner.without("failures")
    return cleaner.until("standardize").whole(pair.take)


def standard_truth(pair: PairedTake, draft: Draft) -> Array:
    """Return the mocap of a pair beside its draft's standard postures [m], (T, J, 3).

    NaN where mocap has none; moved so that the hips' middle, which errors are relative
    to, is where the measurement has it.
    """
    hips, measured = draft.skeleton.hips, draft.measured
    shift = measured[:, hips].mean(axis=1) - pair.truth[:, hips].mean(axis=1)
    truth = pair.truth + shift[:, None]
    filled = np.where(np.isnan(truth), measured, truth)
    standard = Standardizer(draft.body).standardize(filled, draft.heading)
    return np.where(np.isnan(truth), np.nan, standard)


def _standardized(pair: PairedTake, config: CleanConfig | None) -> tuple[Array, ...]:
    """Return the arrays of a training set for a take, in their order."""
    draft = observed(pair, config)
    lengths = np.tile(draft.body.lengths, (len(pair.take), 1))
    truth = standard_truth(pair, draft)
    return (
        draft.standard,
        draft.reliability,
        truth,
        lengths,
        draft.time,
        draft.heading.origin,
    )
