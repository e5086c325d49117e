"""Feet of another skeleton that stay where they stand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kinefilter.characters.arrays import Array, Flags, runs

_BLEND = 0.15
"""Seconds in which a foot joins its own path after it stood, and leaves it before. A
guess."""
_TINY = 1e-12


def smooth_step(share: Array) -> Array:
    """Return 0 up to 0 and 1 from 1 on, between them the cubic level at both ends."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def near_stance(time: Array, stands: Flags) -> Array:
    """Return 1 (T,) while something stands, falling to 0 in 0.15 s before and after."""
    last = np.maximum.accumulate(np.where(stands, time, -np.inf))
    following = np.minimum.accumulate(np.where(stands, time, np.inf)[::-1])[::-1]
    return 1.0 - smooth_step(np.minimum(time - last, following - time) / _BLEND)


def held(time: Array, path: Array, stands: Flags, height: float, slack: float) -> Array:
    """Return the move [m] (T, 3) by which a part of a foot rests while it stands.

    Steps keep their own path but for their beginning and end. The path (T, 3) [m] has y
    up, floor at 0; a standing part is at ``height`` [m] and may rest ``slack`` [m]
    aside from its path. Beyond, it is dragged along, or a body that drifts away would
    pull its leg straight.
    """
    moves, stances = np.zeros((len(time), 3)), runs(stands)
    for stance in stances:
        steps = -np.diff(path[stance][:, [0, 2]], axis=0)
        moves[stance, 0], moves[stance, 2] = _within(slack, steps).T
        moves[stance, 1] = height - path[stance, 1]
    for before, after in pairwise([None, *stances, None]):
        first = 0 if before is None else before.stop
        gap = slice(first, len(time) if after is None else after.start)
        ended, begins = np.zeros((2, gap.stop - gap.start))
        if before is not None:
            ended = 1.0 - smooth_step((time[gap] - time[first - 1]) / _BLEND)
        if after is not None:
            begins = 1.0 - smooth_step((time[gap.stop] - time[gap]) / _BLEND)
        # Each counts the less the nearer the other is, and alone beside its own stance.
        old, new = ended * (1.0 - begins), begins * (1.0 - ended)
        some = (ended + begins - ended * begins) / np.maximum(old + new, _TINY)
        if before is not None:
            moves[gap] += (some * old)[:, None] * moves[first - 1]
        if after is not None:
            moves[gap] += (some * new)[:, None] * moves[gap.stop]
    return moves


def _within(slack: float, steps: Array) -> Array:
    """Return the sums of steps (T - 1, 2) [m] about their middle, dragged, (T, 2)."""
    moves = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moves[0] = _shortened(-0.5 * (moves.max(axis=0) + moves.min(axis=0)), slack)
    for k, step in enumerate(steps):
        moves[k + 1] = _shortened(moves[k] + step, slack)
    return moves


def _shortened(move: Array, most: float) -> Array:
    return np.asarray(move * (most / max(float(np.hypot(*move)), most)))
