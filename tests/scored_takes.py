"""A still person's takes, how to disturb them, and their scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, Skeleton, State, Take, standard_body
from kinefilter.pipeline.reliability import Reference, ReliabilityScorer, Scores

__all__ = [
    "HAND",
    "Array",
    "average",
    "blind",
    "moved",
    "score",
    "still_take",
    "with_state",
]

Array = NDArray[np.float64]
HAND = KINECT_V1.index("HandLeft")


def still_take(
    frames: int = 20, skeleton: Skeleton = KINECT_V1, fps: float = 30.0
) -> Take:
    rest = standard_body(skeleton).rest_positions
    return Take(
        time=np.arange(frames) / fps,
        positions=np.tile(rest, (frames, 1, 1)),
        state=np.full((frames, len(skeleton)), int(State.TRACKED), dtype=np.uint8),
        skeleton=skeleton,
    )


def moved(take: Take, joint: int, path: Array) -> Take:
    """Return a take with a joint displaced, path (T, 3) or (3,)."""
    positions = take.positions.copy()
    positions[:, joint] += path
    return replace(take, positions=positions)


def with_state(take: Take, frames: slice, joint: int, state: State) -> Take:
    states = take.state.copy()
    states[frames, joint] = state
    return replace(take, state=states)


def blind(skeleton: Skeleton = KINECT_V1) -> Reference:
    """Return a reference that knows no segment, so that no length can be wrong."""
    unknown = np.full(len(skeleton), np.nan)
    return Reference(unknown, np.full((len(skeleton), 3), np.nan), False)


def average(skeleton: Skeleton = KINECT_V1) -> Reference:
    lengths = standard_body(skeleton).lengths.copy()
    lengths[skeleton.root] = np.nan
    return replace(blind(skeleton), lengths=lengths)


def score(take: Take, reference: Reference) -> Scores:
    return ReliabilityScorer(take.skeleton, reference).score(take)
