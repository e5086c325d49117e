"""What the take itself shows of how a hidden limb moves.

A Gaussian process learns, from stretches of the take in which the limb was seen, how
far it departs from continuing its motion (Liu 2016's local Gaussian process, for
changes instead of postures). Its prediction is weighted by how much it would have
helped in stretches that it did not learn from.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from kinefilter.characters.arrays import Array, Indices, runs
from kinefilter.characters.rotations import unit
from kinefilter.pipeline.workers import one_blas_thread

from .continuity import CONTEXT
from .prior import MotionPrior
from .windows import BridgedMotion, Descriptions, Limb, Stretches

SHORTEST = 0.4  # s: shorter gaps are only bridged, which a spline does well
_LONGEST = 2.0  # s: longest stretch to learn from
_NOISE = 0.3  # against an amplitude of 1
_REACH = 600.0  # s around a gap to learn from; bounds the cost in long takes. A guess.
_STRETCHES = 200  # candidates to learn from
_SAMPLES = 3  # frames of each
_KEPT = 300  # samples nearest to the gap that are kept: the cost grows with the cube
_FOLDS = 4  # parts of the take, each predicted from the others
_MOMENTUM = 1.0  # share of its speed that a limb keeps, unless the take shows more
_DOUBT = 0.1  # departure of a direction against which that share is weighed
_FEW = 16  # stretches as long as the gap: a take that shows so many doubles the doubt
_BLUR = 0.2  # s: shorter holes in the frames that are seen are ignored


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process on features, with unit length scales and amplitude."""

    weights: Array
    factor: tuple[Array, bool]

    @classmethod
    def of(cls, kernel: Array, targets: Array) -> Process:
        """Fit targets (N, C) of samples with a kernel (N, N) between them."""
        factor = cho_factor(kernel + _NOISE**2 * np.eye(len(kernel)), lower=True)
        return cls(cho_solve(factor, targets), factor)

    def predict(self, kernel: Array) -> Array:
        """Return the mean times one minus the variance, shape (M, C).

        The kernel (M, N) is that between what is asked and the samples.
        """
        half = solve_triangular(self.factor[0], kernel.T, lower=True)
        variance = 1.0 - np.sum(half**2, axis=0)
        certainty = 1.0 - np.clip(variance, 0.0, 1.0)
        return np.asarray(certainty[:, None] * (kernel @ self.weights))


@dataclass(frozen=True, eq=False)
class Recall:
    """What a take shows of the motion of a hidden limb."""

    features: Array  # of the samples of the process
    process: Process | None
    weight: float  # of the process, by its benefit where the limb was seen, in [0, 1]
    momentum: float  # share of its speed that the limb keeps when it is hidden, about 1

    def __call__(self, found: Descriptions) -> Array:
        """Return the directions of hidden segments, shape (W, M, H, 3)."""
        base = found.still + self.momentum * (found.base - found.still)
        if self.process is not None:
            kernel = kernel_between(_rows(found.features), self.features)
            change = self.weight * self.process.predict(kernel)
            base = base + change.reshape(base.shape)
        return unit(base)


def learn(
    seen: BridgedMotion,
    limb: Limb,
    length: int,
    queries: Array | None,
    prior: MotionPrior,
    *,
    ahead: bool,
    gap: int | None = None,
) -> Recall | None:
    """Learn from the stretches of a take in which a limb is seen; None if too few.

    The gap begins with the frame ``gap`` and has ``length`` frames; ``ahead`` is True
    if the motion after it is known. Of many samples, those most similar to ``queries``,
    the features of some of its frames (M, F), are kept; None keeps an even selection.
    Without ``gap``, the whole take is used instead of the minutes around it. The result
    adds to the ``prior``.
    """
    context, first, around = max(round(CONTEXT * seen.rate), 2), 0, slice(None)
    if gap is not None:
        reach = round(_REACH * seen.rate)
        first = max(gap - reach, 0)
        around = slice(first, gap + reach)
    usable = np.all(seen.known[around][:, [*limb.hidden, *limb.visible]], axis=1)
    for hole in runs(~usable):
        if hole.stop - hole.start <= _BLUR * seen.rate and hole.start > 0:
            usable[hole] = True
    usable &= seen.joined[around]
    spans = runs(usable, 2 * context + round(0.3 * seen.rate))
    if not spans:
        return None
    longest = max(s.stop - s.start for s in spans) - 2 * context
    most = min(length, longest, round(_LONGEST * seen.rate))
    parts = []
    for frames in sorted({most, max(round(0.75 * most), min(most, 3))}):
        starts = np.concatenate(
            [np.arange(s.start + context, s.stop - context - frames + 1) for s in spans]
        )
        chosen = np.linspace(0, len(starts) - 1, min(_STRETCHES // 2, len(starts)))
        starts = starts[np.unique(chosen.astype(int))] + first
        at = np.linspace(0, frames - 1, _SAMPLES + 2)[1:-1]
        # Different frames in every stretch, to cover all times from the ends.
        shift = np.arange(len(starts)) * 0.618 % 1.0 - 0.5
        at = np.rint(at + shift[:, None] * frames / (_SAMPLES + 1)).astype(int)
        at = np.clip(at, 0, frames - 1)
        found = prior.describe(Stretches(seen, limb, starts, frames, at, ahead))
        changes = found.base - found.still, found.truth - found.still
        begins = np.repeat(starts, _SAMPLES)
        rows = map(_rows, (found.features, *changes))
        parts.append((*rows, begins, begins + frames))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    count = len(columns[0])
    near = np.arange(0, count, -(-count // _KEPT))
    if queries is not None and count > _KEPT:
        near = _squares(queries, columns[0]).min(axis=0).argsort(kind="stable")[:_KEPT]
    features, moving, targets, begins, ends = (column[near] for column in columns)
    doubt = len(near) * _DOUBT**2 * (1.0 + _FEW * most / usable.sum())
    kept = float(np.sum(moving * targets)) + _MOMENTUM * doubt
    momentum = float(np.clip(kept / (np.sum(moving**2) + doubt), 0.0, 1.5))
    targets = targets - momentum * moving
    # With two threads, a matrix this small can take half a second on a busy machine.
    with one_blas_thread():
        kernel = kernel_between(features, features)
        weight = _weight(kernel, targets, begins, ends)
        process = Process.of(kernel, targets) if weight > 0.0 else None
    return Recall(features, process, weight, momentum)


def _weight(kernel: Array, targets: Array, begins: Indices, ends: Indices) -> float:
    """Return the weight, in [0, 1], with which each part is best predicted by the rest.

    The kernel (N, N) is that between the samples, whose stretches are those from
    ``begins`` to before ``ends``, (N,).
    """
    bounds = np.quantile(begins, np.linspace(0.0, 1.0, _FOLDS + 1))
    gains, squares = [], []
    for low, high in pairwise(bounds):
        held_out = (begins >= low) & (begins <= high)
        if not held_out.any():
            continue
        overlaps = (ends > begins[held_out].min()) & (begins < ends[held_out].max())
        rest = ~overlaps
        if rest.sum() < 2 * _SAMPLES:
            continue
        process = Process.of(kernel[np.ix_(rest, rest)], targets[rest])
        predicted = process.predict(kernel[np.ix_(held_out, rest)])
        gains.extend(np.sum(predicted * targets[held_out], axis=1))
        squares.extend(np.sum(predicted * predicted, axis=1))
    total = float(np.sum(squares))
    if total < 1e-9:
        return 0.0
    # Minus one standard error, so that a benefit by chance does not count. The frames
    # of a stretch count as one.
    error = float(np.std(gains)) * np.sqrt(len(gains) * _SAMPLES)
    return float(np.clip((np.sum(gains) - error) / total, 0.0, 1.0))


def kernel_between(a: Array, b: Array) -> Array:
    """Return the kernel between features (A, F) and (B, F), shape (A, B)."""
    return np.exp(-0.5 * _squares(a, b))


def _squares(a: Array, b: Array) -> Array:  # distances of rows, shape (A, B)
    squares = np.vecdot(a, a)[:, None] + np.vecdot(b, b) - 2.0 * a @ b.T
    return np.asarray(np.maximum(squares, 0.0))


def _rows(values: Array) -> Array:  # (W, M, ...) as (W M, C)
    return np.reshape(values, (values.shape[0] * values.shape[1], -1))
