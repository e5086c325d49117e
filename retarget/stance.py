"""Moves that hold the planted feet of another skeleton in place."""

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters.arrays import Array, Flags, runs

_BLEND = 0.15  # s in which a foot goes from its path to its stance, and back. A guess.
_TINY = 1e-12


def smooth_step(share: ArrayLike) -> Array:
    """Return the cubic that rises from 0 at 0 to 1 at 1, constant beyond."""
    inside = np.clip(np.asarray(share), 0.0, 1.0)
    return np.asarray(inside**2 * (3.0 - 2.0 * inside))


def near_stance(time: Array, planted: Flags) -> Array:
    """Return 1 (T,) in frames with contact, falling to 0 in 0.15 s before and after."""
    return np.asarray(np.maximum(*_nearness(time, planted)))


def _nearness(time: Array, planted: Flags) -> tuple[Array, Array]:
    """Return ``near_stance`` for the last contact alone and for the next alone."""
    last = np.maximum.accumulate(np.where(planted, time, -np.inf))
    following = np.minimum.accumulate(np.where(planted, time, np.inf)[::-1])[::-1]
    ended, begins = (time - last) / _BLEND, (following - time) / _BLEND
    return 1.0 - smooth_step(ended), 1.0 - smooth_step(begins)


def holding_moves(
    time: Array, path: Array, planted: Flags, height: float, slack: float
) -> Array:
    """Return the move [m] (T, 3) that keeps a heel or toes in place while planted.

    Steps change only where they begin and end. The path (T, 3) [m] has y up and the
    floor at 0. While planted, the part is at ``height`` [m] and may be ``slack`` [m]
    away from its path. Beyond that it is dragged along, because a body that drifts away
    would otherwise pull its leg straight.
    """
    moves, frames = np.zeros((len(time), 3)), np.arange(len(time))
    for stance in runs(planted):
        steps = -np.diff(path[stance][:, [0, 2]], axis=0)
        moves[stance, 0], moves[stance, 2] = _dragged(steps, slack).T
        moves[stance, 1] = height - path[stance, 1]
    ended, begins = _nearness(time, planted)
    # The nearer stance has the larger weight, and all of it next to itself.
    old, new = ended * (1.0 - begins), begins * (1.0 - ended)
    some = (ended + begins - ended * begins) / np.maximum(old + new, _TINY)
    last = np.maximum.accumulate(np.where(planted, frames, 0))
    following = np.minimum.accumulate(np.where(planted, frames, frames[-1])[::-1])[::-1]
    between = (some * old)[:, None] * moves[last]
    between += (some * new)[:, None] * moves[following]
    return np.where(planted[:, None], moves, between)


def _dragged(steps: Array, slack: float) -> Array:
    """Return sums (T, 2) of steps (T - 1, 2) [m], centered and kept within slack."""
    moves = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moves[0] = _shortened(-0.5 * (moves.max(axis=0) + moves.min(axis=0)), slack)
    for k, step in enumerate(steps):
        moves[k + 1] = _shortened(moves[k] + step, slack)
    return moves


def _shortened(move: Array, most: float) -> Array:
    return np.asarray(move * (most / max(float(np.hypot(*move)), most)))
