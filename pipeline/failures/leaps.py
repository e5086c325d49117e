"""Limbs that are elsewhere from one moment to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability.shum import column_medians

_LEAP = 0.6
"""How far a limb's joint leaps, as a share of the segment that ends there: 35 degrees.
The most that 126 clips of marker mocap hold, punches and dances among them, is 0.5."""
_LEAP_TIME = 1.0 / 15.0
"""Time [s] too short to go from rest to rest: the fastest voluntary contractions last
about a tenth of a second, however small they are (Freund & Buedingen 1978, Experimental
Brain Research 31:1-12)."""
_REST = 0.1
"""Time before and after a leap over which movement counts against it [s]: a quick limb
is still on its way then."""
_SLACK = 1.25  # share of _LEAP_TIME that two frames of an uneven clock may take
_SEGMENTS = {
    "arm": (("Shoulder", "Elbow"), ("Elbow", "Wrist")),
    "leg": (("Hip", "Knee"), ("Knee", "Ankle")),
}


def leaps(take: Take, side: str, limb: str) -> NDArray[np.bool_]:
    """Return the frames in which a limb leaps, shape (T,).

    Sensors that lose a limb leave it where it was, or on something else, and find it
    again all at once.

    Args:
        take: The recording.
        side: ``Left`` or ``Right``.
        limb: ``arm`` or ``leg``.
    """
    frames = np.zeros(len(take), dtype=bool)
    lag, rest = round(_LEAP_TIME * take.fps), max(1, round(_REST * take.fps))
    # A slow sensor, or one that dropped frames, leaves a limb the time to get there.
    if lag < 1 or len(take) < lag + 2 * rest + 1:
        return frames
    quick = take.time[lag:] - take.time[:-lag] <= _SLACK * _LEAP_TIME
    for start, end in _SEGMENTS[limb]:
        far = _contrasts(_bones(take, start, end, side), lag, rest) > _LEAP
        for k in np.flatnonzero(far & quick):
            frames[k : k + lag + 1] = True
    return frames


def _bones(take: Take, start: str, end: str, side: str) -> Array:
    """Return a segment's vectors, in lengths of it, shape (T, 3).

    The longer of both sides' medians is its length: lost limbs shrink.
    """
    index, positions = take.skeleton.index, take.positions
    vectors = {
        s: positions[:, index(end + s)] - positions[:, index(start + s)]
        for s in ("Left", "Right")
    }
    lengths = np.stack([np.linalg.norm(v, axis=1) for v in vectors.values()], axis=1)
    medians = np.nan_to_num(column_medians(lengths))
    return np.asarray(vectors[side] / max(medians.max(), 1e-3))


def _contrasts(bones: Array, lag: int, rest: int) -> Array:
    """Return how far the vectors move in ``lag`` frames, less just before and after.

    Shape (T - lag,), from the frame that each movement begins with.
    """
    moved = np.linalg.norm(bones[lag:] - bones[:-lag], axis=1)
    before, after = np.zeros((2, len(bones)))
    for k in range(1, rest + 1):
        step = np.linalg.norm(bones[k:] - bones[:-k], axis=1)
        before[k:], after[:-k] = (
            np.maximum(before[k:], step),
            np.maximum(after[:-k], step),
        )
    contrasts = moved - before[:-lag] - after[lag:]
    # Whoever comes into the picture, or leaves it, was not at rest.
    contrasts[:rest] = contrasts[len(contrasts) - rest :] = 0.0
    return np.asarray(np.nan_to_num(contrasts))
