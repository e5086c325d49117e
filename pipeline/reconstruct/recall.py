"""How a hidden limb moved before, in this take, when it was seen.

A Gaussian process learns, from stretches of the take in which the limb was seen, how
far it departs from where it would go on (Liu 2016's local Gaussian process, of changes
in place of postures). What it says counts as far as it would have helped in stretches
that it did not learn from.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from kinefilter.characters.arrays import Array, Indices, runs
from kinefilter.characters.rotations import unit

from .continuity import CONTEXT
from .prior import MotionPrior
from .windows import Limb, Seen, Stretches, Windows

SHORTEST = 0.4
"""Shorter gaps [s] are bridged and nothing else: a spline does them well."""
LONGEST = 2.0
"""Longest stretch [s] to learn from."""
_NOISE = 0.3  # of the amplitude of what is learned
_REACH = 600.0  # s around a gap that teach, so that hours do not cost days; a guess
_STRETCHES = 200  # candidates to learn from
_SAMPLES = 3  # frames of each
_KEPT = 300  # those nearest to the gap: the cost grows with the cube
_FOLDS = 4  # parts of the take, each judged by what the others teach
_MOMENTUM = 1.0  # of its speed that a limb keeps, as long as nothing else is known
_DOUBT = 0.1  # departure of a direction that this is worth
_BLUR = 0.2  # s of seen frames that may be missing in between


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process on features, with unit lengths and amplitude."""

    features: Array
    weights: Array
    factor: tuple[Array, bool]

    @classmethod
    def of(cls, features: Array, targets: Array) -> Process:
        """Learn targets (N, C) at features (N, F)."""
        matrix = _kernel(features, features)
        matrix.flat[:: len(matrix) + 1] += _NOISE**2
        factor = cho_factor(matrix, lower=True)
        return cls(features, cho_solve(factor, targets), factor)

    def predict(self, features: Array) -> Array:
        """Return the mean times how well it is known, shape (N, C)."""
        kernel = _kernel(features, self.features)
        variance = 1.0 - np.sum(kernel.T * cho_solve(self.factor, kernel.T), axis=0)
        return np.asarray(
            (1.0 - np.clip(variance, 0.0, 1.0))[:, None] * (kernel @ self.weights)
        )


@dataclass(frozen=True, eq=False)
class Recall:
    """What a take teaches about a limb while it is hidden."""

    process: Process | None
    worth: float
    """How much of what it says helps where the limb was seen, in [0, 1]."""
    momentum: float
    """How much of its speed the limb keeps when it is hidden, about 1."""

    def __call__(self, found: Windows) -> Array:
        """Return the directions of hidden segments, shape (W, M, H, 3)."""
        base = found.still + self.momentum * (found.base - found.still)
        if self.process is not None:
            change = self.worth * self.process.predict(_rows(found.features))
            base = base + change.reshape(base.shape)
        return unit(base)


def learn(
    seen: Seen,
    limb: Limb,
    length: int,
    queries: Array | None,
    prior: MotionPrior,
    *,
    ahead: bool,
    gap: int | None = None,
) -> Recall | None:
    """Learn from the seen stretches of a take; None where there are too few.

    Args:
        seen: The take.
        limb: What is hidden.
        length: Frames of the gap.
        queries: Features of the gap's frames, shape (M, F): what is most like them is
            learned; None: all alike.
        prior: What people mostly do: what the take shows is learned on top of it.
        ahead: Whether what comes after the gap is known.
        gap: Its first frame; None: what is far away teaches as well.
    """
    context = max(round(CONTEXT * seen.rate), 2)
    reach = round(_REACH * seen.rate)
    first = 0 if gap is None else max(gap - reach, 0)
    around = slice(first, None if gap is None else gap + reach)
    usable = np.all(seen.known[around][:, [*limb.hidden, *limb.visible]], axis=1)
    for hole in runs(~usable):
        if hole.stop - hole.start <= _BLUR * seen.rate and hole.start > 0:
            usable[hole] = True
    usable &= seen.joined[around]
    spans = runs(usable, 2 * context + round(0.3 * seen.rate))
    if not spans:
        return None
    longest = max(s.stop - s.start for s in spans) - 2 * context
    most = min(length, longest, round(LONGEST * seen.rate))
    stretches = []
    for frames in sorted({most, max(round(0.75 * most), min(most, 3))}):
        starts = np.concatenate(
            [np.arange(s.start + context, s.stop - context - frames + 1) for s in spans]
        )
        few = np.linspace(0, len(starts) - 1, min(_STRETCHES // 2, len(starts)))
        starts = starts[np.unique(few.astype(int))] + first
        at = np.linspace(0, frames - 1, _SAMPLES + 2)[1:-1]
        # Other frames in every stretch, so that all times from the ends occur.
        shift = np.arange(len(starts)) * 0.618 % 1.0 - 0.5
        at = np.rint(at + shift[:, None] * frames / (_SAMPLES + 1)).astype(int)
        at = np.clip(at, 0, frames - 1)
        found = prior.describe(Stretches(seen, limb, starts, frames, at, ahead))
        begins = np.repeat(starts, _SAMPLES)
        stretches.append((found, begins, begins + frames))
    features = np.concatenate([_rows(w.features) for w, _, _ in stretches])
    near = np.arange(len(features))[:: -(-len(features) // _KEPT)]
    if queries is not None and len(features) > _KEPT:
        few = queries[:: max(len(queries) // 12, 1)]
        distance = _squares(few, features).min(axis=0)
        near = np.argsort(distance, kind="stable")[:_KEPT]
    moving, targets, begins, ends = (
        np.concatenate(parts)[near]
        for parts in zip(
            *(
                (_rows(w.base - w.still), _rows(w.truth - w.still), begin, end)
                for w, begin, end in stretches
            ),
            strict=True,
        )
    )
    features, doubt = features[near], len(near) * _DOUBT**2
    kept = float(np.sum(moving * targets)) + _MOMENTUM * doubt
    momentum = float(np.clip(kept / (np.sum(moving**2) + doubt), 0.0, 1.5))
    targets = targets - momentum * moving
    worth = _worth(features, targets, begins, ends)
    process = Process.of(features, targets) if worth > 0.0 else None
    return Recall(process, worth, momentum)


def _worth(features: Array, targets: Array, begins: Indices, ends: Indices) -> float:
    """Return how much of each part of the take the rest of it predicts, in [0, 1]."""
    parts = np.quantile(begins, np.linspace(0.0, 1.0, _FOLDS + 1))
    gains, squares = [], []
    for low, high in pairwise(parts):
        held_out = (begins >= low) & (begins <= high)
        if not held_out.any():
            continue
        overlaps = (ends > begins[held_out].min()) & (begins < ends[held_out].max())
        if (~overlaps).sum() < 2 * _SAMPLES:
            continue
        process = Process.of(features[~overlaps], targets[~overlaps])
        said = process.predict(features[held_out])
        gains.extend(np.sum(said * targets[held_out], axis=1))
        squares.extend(np.sum(said * said, axis=1))
    total = float(np.sum(squares))
    if total < 1e-9:
        return 0.0
    # Less one standard error: what helps by chance does not count. The frames of a
    # stretch count as one.
    error = float(np.std(gains)) * np.sqrt(len(gains) * _SAMPLES)
    return float(np.clip((np.sum(gains) - error) / total, 0.0, 1.0))


def _kernel(a: Array, b: Array) -> Array:
    return np.asarray(np.exp(-0.5 * _squares(a, b)))


def _squares(a: Array, b: Array) -> Array:
    """Return squared distances of rows, shape (A, B)."""
    squares = np.sum(a * a, axis=1)[:, None] + np.sum(b * b, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.maximum(squares, 0.0))


def _rows(values: Array) -> Array:
    return np.reshape(values, (values.shape[0] * values.shape[1], -1))
