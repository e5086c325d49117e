"""Left and right exchanged: found, and put back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Take
from kinefilter.retarget.runs import runs

from .failure import Failure, FailureKind
from .trunk import leftward

_SPIN = np.radians(120.0)
_SPIN_TIME = 1.0 / 6.0
"""Nobody turns the trunk by that much [rad] in this time [s]: figure skaters reach six
revolutions a second, dancers two, and this is two."""
_MENDS = 0.7
"""Share of the jump into and out of a mirrored stretch that exchanging sides leaves at
most, where it mends anything. A guess."""


def mirrored(take: Take) -> NDArray[np.bool_]:
    """Return the frames between impossible turns that are the fewer, shape (T,)."""
    frames = np.zeros(len(take), dtype=bool)
    left = np.nan_to_num(leftward(take)[:, [0, 2]])
    lag = max(1, round(_SPIN_TIME * len(take) / (take.time[-1] - take.time[0])))
    if len(take) <= lag:
        return frames
    norms = np.maximum(np.linalg.norm(left, axis=1), 1e-9)
    cosines = np.sum(left[lag:] * left[:-lag], axis=1) / (norms[lag:] * norms[:-lag])
    # A turn shows in all pairs of frames that have it between them.
    spins = runs(cosines < np.cos(_SPIN))
    turns = [(run.start + run.stop - 1) // 2 + lag // 2 + 1 for run in spins]
    for k, turn in enumerate(turns):
        end = turns[k + 1] if k + 1 < len(turns) else len(take)
        frames[turn:end] = k % 2 == 0
    return frames if frames.mean() <= 0.5 else ~frames


def unmirrored(take: Take, failures: Iterable[Failure]) -> Take:
    """Return a take whose left and right are exchanged back where they were.

    They stay where the body would jump as far either way: then more is wrong with it.
    """
    frames = np.zeros(len(take), dtype=bool)
    for failure in failures:
        if failure.kind is FailureKind.MIRRORED:
            edges = [
                (failure.first, failure.first - 1),
                (failure.last, failure.last + 1),
            ]
            edges = [edge for edge in edges if 0 <= edge[1] < len(take)]
            jumps = [_jump(take, *edge, mirror=False) for edge in edges]
            mended = [_jump(take, *edge, mirror=True) for edge in edges]
            frames[failure.frames] = sum(mended) < _MENDS * sum(jumps)
    return _exchanged(take, frames)


def _exchanged(take: Take, frames: NDArray[np.bool_]) -> Take:
    """Return a take with left and right exchanged in some frames."""
    if not frames.any():
        return take
    mirror = take.skeleton.mirror
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames] = positions[frames][:, mirror]
    state[frames] = state[frames][:, mirror]
    return replace(take, positions=positions, state=state)


def _jump(take: Take, inside: int, outside: int, *, mirror: bool) -> float:
    """Return how far joints move from a frame to another, the root apart [m]."""
    relative = take.positions - take.positions[:, [take.skeleton.root]]
    frame = relative[inside]
    if mirror:
        frame = frame[take.skeleton.mirror]
    return float(np.nanmean(np.linalg.norm(frame - relative[outside], axis=1)))
