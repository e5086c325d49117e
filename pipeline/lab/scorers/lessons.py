"""How reliability scoring learns: joints far off in simulated takes, and what told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.pipeline.reliability import measure_reference

from .doubt import DoubtWeights, kind_of
from .learned import TERMS, LearnedReliabilityScorer

FAR_OFF = 0.10
"""How far a joint must be from the truth to count as far off [m], relative to the
middle of the hips."""
_EVERY = 4  # frame of the lessons: the next ones say the same
_CAUTION = 1.0  # inverse strength of the penalty on large weights


def learned_weights(
    pairs: Sequence[PairedTake], *, progress: Progress = silent
) -> DoubtWeights:
    """Return what tells joints that are far off, learned from pairs of one skeleton.

    Args:
        pairs: Takes and their truth.
        progress: Wraps the loop over the takes, for a progress bar.
    """
    skeleton = pairs[0].take.skeleton
    seen, far = zip(
        *(_lesson(pairs[k]) for k in progress("look", len(pairs))), strict=True
    )
    return _fitted(skeleton, np.concatenate(seen), np.concatenate(far))


def _lesson(pair: PairedTake) -> tuple[Array, Array]:
    """Return clues (T, J, C) and whether joints are far off (T, J), NaN unknown."""
    take, skeleton = pair.take, pair.take.skeleton
    nothing = untaught(skeleton)
    scorer = LearnedReliabilityScorer(skeleton, measure_reference(take), nothing)
    frames = zip(take.positions, take.state, take.time, strict=True)
    clues = [scorer.clues(p, state, float(time)) for p, state, time in frames]
    away = take.positions - pair.truth
    away = away - away[:, skeleton.hips].mean(axis=1, keepdims=True)
    distance = np.linalg.norm(away, axis=2)
    far = np.where(np.isnan(distance), np.nan, distance > FAR_OFF)
    return np.array(clues[::_EVERY]), far[::_EVERY]


def untaught(skeleton: Skeleton) -> DoubtWeights:
    """Return weights that know nothing: every joint has even odds."""
    nothing = np.zeros((len(skeleton), len(TERMS)))
    return DoubtWeights(skeleton, nothing, nothing, nothing[:, 0])


def _fitted(skeleton: Skeleton, clues: Array, far: Array) -> DoubtWeights:
    """Return a logistic regression for each kind of joint, on clues (N, J, C)."""
    from sklearn.linear_model import LogisticRegression

    nothing = untaught(skeleton)
    usual, weights = nothing.usual.copy(), nothing.weights.copy()
    intercepts = nothing.intercepts.copy()
    kinds = np.array([kind_of(joint) for joint in skeleton.joints])
    for kind in dict.fromkeys(kinds):
        joints = np.flatnonzero(kinds == kind)
        known = ~np.isnan(far[:, joints])
        inputs, wrong = clues[:, joints][known], far[:, joints][known]
        # Laplace's rule: without any lesson the odds are even.
        intercepts[joints] = np.log((wrong.sum() + 1.0) / ((1.0 - wrong).sum() + 1.0))
        if not 0.0 < wrong.sum() < len(wrong):
            continue
        mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
        spread = np.where(spread > 1e-6, spread, np.inf)
        model = LogisticRegression(C=_CAUTION, max_iter=500)
        model.fit((inputs - mean) / spread, wrong)
        usual[joints], weights[joints] = mean, model.coef_[0] / spread
        intercepts[joints] = model.intercept_[0]
    return DoubtWeights(skeleton, usual, weights, intercepts)
