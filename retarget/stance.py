"""Feet of another skeleton that stay where they stand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["held", "near_stance"]

Array = NDArray[np.float64]

_BLEND = 0.15
"""Seconds in which a foot joins its own path after it stood, and leaves it before."""
_SLACK = 0.015
"""How far [m] a standing foot is from its path at most: beyond, it is dragged along, or
a body that drifts away would pull its leg straight."""
_TINY = 1e-12


def near_stance(time: Array, stands: NDArray[np.bool_]) -> Array:
    """Return 1 while something stands, falling to 0 in 0.15 s before and after, (T,).

    Args:
        time: Time stamps [s], never decreasing, shape (T,).
        stands: Whether it stands, shape (T,).
    """
    last = np.maximum.accumulate(np.where(stands, time, -np.inf))
    following = np.minimum.accumulate(np.where(stands, time, np.inf)[::-1])[::-1]
    return _ease(np.minimum(time - last, following - time) / _BLEND)


def held(
    time: Array, heel: Array, toe: Array, stands: NDArray[np.bool_], heights: Array
) -> Array:
    """Return how a foot has to be moved so that it rests while it stands.

    Where the toes stand they rest, where heel and toes stand both do as well as the
    foot's turning lets them, where the heel alone stands the ankle over it does. Steps
    keep their own path but for their beginning and end.

    Args:
        time: Time stamps [s], never decreasing, shape (T,).
        heel: Path of the ankle [m], y up, floor at 0, shape (T, 3).
        toe: Path of the toes, likewise.
        stands: Whether heel and toes stand, shape (T, 2).
        heights: Heights [m] of ankle and toes of a foot that stands flat, shape (2,).

    Returns:
        Move of the foot [m], shape (T, 3).
    """
    moves = np.zeros((len(time), 3))
    stances = _runs(stands[:, 0] | stands[:, 1])
    for stance in stances:
        moves[stance] = _resting(heel[stance], toe[stance], stands[stance], heights)
    for before, after in pairwise([None, *stances, None]):
        first = 0 if before is None else before.stop
        gap = slice(first, len(time) if after is None else after.start)
        ended, begins = np.zeros((2, gap.stop - gap.start))
        if before is not None:
            ended = _ease((time[gap] - time[first - 1]) / _BLEND)
        if after is not None:
            begins = _ease((time[gap.stop] - time[gap]) / _BLEND)
        # Each counts the less the nearer the other is, and alone beside its own stance.
        old, new = ended * (1.0 - begins), begins * (1.0 - ended)
        some = (ended + begins - ended * begins) / np.maximum(old + new, _TINY)
        if before is not None:
            moves[gap] += (some * old)[:, None] * moves[first - 1]
        if after is not None:
            moves[gap] += (some * new)[:, None] * moves[gap.stop]
    return moves


def _resting(
    heel: Array, toe: Array, stands: NDArray[np.bool_], heights: Array
) -> Array:
    """Return the move of a foot in one stance [m], shape (T, 3)."""
    weights = stands / stands.sum(axis=1, keepdims=True)
    both = stands[1:] & stands[:-1]
    count = np.maximum(both.sum(axis=1, keepdims=True), 1)
    slid = both[:, :1] * np.diff(heel, axis=0) + both[:, 1:] * np.diff(toe, axis=0)
    move = _within_slack(-(slid / count)[:, [0, 2]])
    lifts = heights - np.stack([heel[:, 1], toe[:, 1]], axis=1)
    # Toes that stand are on the floor, whatever the heel does.
    weights = np.where(stands[:, 1:], [0.0, 1.0], weights)
    lift = np.sum(weights * lifts, axis=1)
    return np.stack([move[:, 0], lift, move[:, 1]], axis=1)


def _within_slack(steps: Array) -> Array:
    """Return the sums of steps (T - 1, 2) [m] about their middle, dragged, (T, 2)."""
    moves = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moves[0] = _shortened(-0.5 * (moves.max(axis=0) + moves.min(axis=0)))
    for k, step in enumerate(steps):
        moves[k + 1] = _shortened(moves[k] + step)
    return moves


def _shortened(move: Array) -> Array:
    return np.asarray(move * (_SLACK / max(float(np.hypot(*move)), _SLACK)))


def _ease(share: Array) -> Array:
    """Return 1 at 0 and 0 from 1 on, smoothly, shape (T,)."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(1.0 - share**2 * (3.0 - 2.0 * share))


def _runs(flags: NDArray[np.bool_]) -> list[slice]:
    """Return where flags are set, run by run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]]).astype(np.int8)))
    return [slice(a, b) for a, b in edges.reshape(-1, 2).tolist()]
