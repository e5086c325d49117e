"""Teach ``--scoring learned`` what goes with joints that are far off.

    python tests/teach_reliability.py

Writes ``pipeline/lab/embedded/*_doubt.npz`` from simulated people who are in no study.
Takes about five minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from sklearn.linear_model import LogisticRegression

from kinefilter.characters import SKELETONS
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.scorers import ClueWeights, LearnedReliabilityScorer
from kinefilter.pipeline.lab.simulation import pairs_with_props
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.reliability import measure_reference

FOLDER = Path(__file__).parents[1] / "pipeline" / "lab" / "embedded"
FAR_OFF = 0.10  # m relative to the hips above which a joint is far off
_EVERY = 4  # every fourth frame is used in training; those between add little
_PENALTY = 1.0  # inverse strength of the penalty on large weights


def learned_weights(pairs: Sequence[PairedTake]) -> ClueWeights:
    """Return weights trained on pairs of one skeleton."""
    clues, far = map(np.concatenate, zip(*map(_clues_and_errors, pairs), strict=True))
    learned = ClueWeights.even_odds(pairs[0].take.skeleton)
    kinds = np.array(learned.skeleton.kinds)
    for kind in dict.fromkeys(kinds):
        joints = np.flatnonzero(kinds == kind)
        known = ~np.isnan(far[:, joints])
        inputs, wrong = clues[:, joints][known], far[:, joints][known]
        # Laplace's rule: even odds without any data.
        odds = (wrong.sum() + 1.0) / ((1.0 - wrong).sum() + 1.0)
        learned.intercepts[joints] = np.log(odds)
        if not 0.0 < wrong.sum() < len(wrong):
            continue
        mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
        spread = np.where(spread > 1e-6, spread, np.inf)
        model = LogisticRegression(C=_PENALTY, max_iter=500)
        model.fit((inputs - mean) / spread, wrong)
        learned.usual[joints], learned.weights[joints] = mean, model.coef_[0] / spread
        learned.intercepts[joints] = model.intercept_[0]
    return learned


def _clues_and_errors(pair: PairedTake) -> tuple[Array, Array]:
    """Return clues (T, J, C), and 1 for joints far off, NaN if unknown, (T, J)."""
    take, skeleton = pair.take, pair.take.skeleton
    untrained = ClueWeights.even_odds(skeleton)
    scorer = LearnedReliabilityScorer(skeleton, measure_reference(take), untrained)
    frames = zip(take.positions, take.state, take.time, strict=True)
    clues = [scorer.clues(p, state, float(time)) for p, state, time in frames]
    errors = take.positions - pair.truth
    errors = errors - errors[:, skeleton.hips].mean(axis=1, keepdims=True)
    distance = np.linalg.norm(errors, axis=2)
    far = np.where(np.isnan(distance), np.nan, distance > FAR_OFF)
    return np.array(clues[::_EVERY]), far[::_EVERY]


def main() -> None:
    for name in SKELETONS:
        learned_weights(pairs_with_props(name)).save(FOLDER / f"{name}_doubt.npz")


if __name__ == "__main__":
    main()
