"""Gross failures of the tracker: found, reported, and mended where that is possible.

Sensors now and then take a person for one who faces the other way, and exchange left
and right from one frame to the next; or they bend a leg the way no knee bends. Both go
on for many frames, so that nothing which looks at single frames or lengths minds them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from kinefilter.characters import Skeleton, Take

from .reliability import Reliability

__all__ = ["Failure", "FailureKind", "distrust", "find_failures", "unmirrored"]

Array = NDArray[np.float64]

_SPIN = np.radians(120.0)
_SPIN_TIME = 1.0 / 6.0
"""Nobody turns the trunk by that much [rad] in this time [s]: figure skaters reach six
revolutions a second, dancers two, and this is two."""
_BACKWARDS = 0.06
"""Share of a leg's length by which a knee is behind the line from hip to ankle: 14
degrees of hyperextension, three times what is normal."""
_MENDS = 0.7
"""Share of the jump into and out of a mirrored stretch that exchanging sides leaves at
most, where it mends anything. A guess."""
_LASTING = 0.8  # s: shorter is noise, or a kick seen from the front
_STEADY = 0.3  # s, of the median over time before the knee is judged
_LEG = ("Knee", "Ankle", "Foot")


class FailureKind(StrEnum):
    """What is wrong with part of a take."""

    MIRRORED = "left and right exchanged"
    BENT_BACKWARDS = "bent backwards at the knee"


@dataclass(frozen=True)
class Failure:
    """A stretch of a take in which the tracker failed."""

    kind: FailureKind
    """What is wrong."""
    part: str
    """What it is wrong with: ``body``, ``left leg`` or ``right leg``."""
    first: int
    """The first frame of it."""
    last: int
    """The last frame of it."""
    start: float
    """Time stamp of the first frame [s]."""
    end: float
    """Time stamp of the last frame [s]."""

    @property
    def frames(self) -> slice:
        """The frames of it."""
        return slice(self.first, self.last + 1)

    def __str__(self) -> str:
        return f"{self.part} {self.kind} from {self.start:.1f} to {self.end:.1f} s"


def find_failures(take: Take) -> tuple[Failure, ...]:
    """Return the gross failures in a take, time stamps strictly increasing."""
    mirrored = _mirrored(take)
    found = _failures(take, FailureKind.MIRRORED, "body", mirrored)
    take = _exchanged(take, mirrored)
    for side in ("Left", "Right"):
        backwards = _bent_backwards(take, side)
        part = f"{side.lower()} leg"
        found += [
            failure
            for failure in _failures(take, FailureKind.BENT_BACKWARDS, part, backwards)
            if failure.end - failure.start >= _LASTING
        ]
    return tuple(sorted(found, key=lambda failure: failure.first))


def unmirrored(take: Take, failures: tuple[Failure, ...]) -> Take:
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


def distrust(
    reliability: Reliability, failures: tuple[Failure, ...], skeleton: Skeleton
) -> Reliability:
    """Return a reliability that is 0 where a leg is bent the way no leg bends."""
    rate, geometry = reliability.rate.copy(), reliability.geometry.copy()
    for failure in failures:
        if failure.kind is FailureKind.BENT_BACKWARDS:
            side = failure.part.split()[0].capitalize()
            leg = [skeleton.index(f"{joint}{side}") for joint in _LEG]
            rate[failure.frames, leg] = 0.0
            geometry[failure.frames, leg] = 0.0
    return replace(reliability, rate=rate, geometry=geometry)


def _jump(take: Take, inside: int, outside: int, *, mirror: bool) -> float:
    """Return how far joints move from a frame to another, the root apart [m]."""
    relative = take.positions - take.positions[:, [take.skeleton.root]]
    frame = relative[inside]
    if mirror:
        frame = frame[take.skeleton.mirror]
    return float(np.nanmean(np.linalg.norm(frame - relative[outside], axis=1)))


def _mirrored(take: Take) -> NDArray[np.bool_]:
    """Return the frames between impossible turns that are the fewer, shape (T,)."""
    frames = np.zeros(len(take), dtype=bool)
    left = np.nan_to_num(_leftward(take)[:, [0, 2]])
    lag = max(1, round(_SPIN_TIME * len(take) / (take.time[-1] - take.time[0])))
    if len(take) <= lag:
        return frames
    norms = np.maximum(np.linalg.norm(left, axis=1), 1e-9)
    cosines = np.sum(left[lag:] * left[:-lag], axis=1) / (norms[lag:] * norms[:-lag])
    # A turn shows in all pairs of frames that have it between them.
    turns = [(a + b) // 2 + lag // 2 + 1 for a, b in _runs(cosines < np.cos(_SPIN))]
    for k, turn in enumerate(turns):
        end = turns[k + 1] if k + 1 < len(turns) else len(take)
        frames[turn:end] = k % 2 == 0
    return frames if frames.mean() <= 0.5 else ~frames


def _leftward(take: Take) -> Array:
    """Return the sum of what points to the left at hips and shoulders [m], (T, 3)."""
    index, positions = take.skeleton.index, take.positions
    return np.asarray(
        sum(
            positions[:, index(f"{part}Left")] - positions[:, index(f"{part}Right")]
            for part in ("Hip", "Shoulder")
        )
    )


def _bent_backwards(take: Take, side: str) -> NDArray[np.bool_]:
    """Return the frames in which a knee is far behind its leg, shape (T,)."""
    skeleton, positions = take.skeleton, take.positions
    hip, knee, ankle = (
        positions[:, skeleton.index(f"{joint}{side}")]
        for joint in ("Hip", "Knee", "Ankle")
    )
    girdle = skeleton.parents[skeleton.index("ShoulderLeft")]
    hips = (
        positions[:, skeleton.index("HipLeft")]
        - positions[:, skeleton.index("HipRight")]
    )
    front = np.cross(hips, positions[:, girdle] - positions[:, skeleton.root])
    front /= np.maximum(np.linalg.norm(front, axis=1, keepdims=True), 1e-9)
    leg, thigh = ankle - hip, knee - hip
    squares = np.maximum(np.sum(leg * leg, axis=1), 1e-9)
    along = np.sum(thigh * leg, axis=1) / squares
    ahead = np.sum((thigh - along[:, None] * leg) * front, axis=1)
    length = np.linalg.norm(thigh, axis=1) + np.linalg.norm(ankle - knee, axis=1)
    share = np.nan_to_num(ahead / np.maximum(np.nanmedian(length), 1e-9))
    rate = (len(take) - 1) / (take.time[-1] - take.time[0])
    width = max(1, round(_STEADY * rate))
    return np.asarray(median_filter(share, width, mode="nearest") < -_BACKWARDS)


def _exchanged(take: Take, frames: NDArray[np.bool_]) -> Take:
    """Return a take with left and right exchanged in some frames."""
    if not frames.any():
        return take
    mirror = take.skeleton.mirror
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames] = positions[frames][:, mirror]
    state[frames] = state[frames][:, mirror]
    return replace(take, positions=positions, state=state)


def _failures(
    take: Take, kind: FailureKind, part: str, frames: NDArray[np.bool_]
) -> list[Failure]:
    return [
        Failure(kind, part, a, b, float(take.time[a]), float(take.time[b]))
        for a, b in _runs(frames)
    ]


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every run of True."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    ends = np.flatnonzero(edges == -1) - 1
    return list(zip(np.flatnonzero(edges == 1).tolist(), ends.tolist(), strict=True))
