"""The raw take of a clip, where the clip's character is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Take
from kinefilter.pipeline.floor import leveled
from kinefilter.pipeline.formats import read_take

__all__ = ["raw_positions"]

Array = NDArray[np.float64]

_APART = 0.1  # s between a frame and the measurement shown for it, at most
_LEAST_TILT = np.radians(1.5)  # below, it is what cleaning moved
_STEPS = 8  # each leaves the square of the angle before


def raw_positions(path: Path, clip: Clip, times: Array) -> Array:
    """Return where the take of a clip has the joints, in the clip's frame.

    Cleaning set the take on the floor, and leveled it if the sensor was tilted; what it
    did shows in where most joints are.

    Args:
        path: The take.
        clip: What was made of it.
        times: Time stamps [s] to show.

    Returns:
        Joint positions [m], NaN where nothing was measured, shape (T, J, 3).

    Raises:
        InputError: The file is no take, or not the one that the clip was made of.
    """
    take = read_take(path)
    if take.skeleton.name != clip.skeleton.name:
        raise InputError(
            f"--compare {path}: a take of {take.skeleton.name}, but the clip has "
            f"{clip.skeleton.name}; give the take that it was made of"
        )
    nearest = _nearest(take.time, times)
    if np.median(np.abs(take.time[nearest] - times)) > _APART:
        raise InputError(
            f"--compare {path}: from {take.time[0]:.2f} to {take.time[-1]:.2f} s, but "
            f"the clip from {times[0]:.2f} to {times[-1]:.2f} s; give the take that it "
            "was made of"
        )
    shown = take.positions[nearest]
    away = np.abs(take.time[nearest] - times) > _APART
    return np.where(away[:, None, None], np.nan, _as_cleaned(take, clip, shown))


def _as_cleaned(take: Take, clip: Clip, shown: Array) -> Array:
    """Return positions leveled and on the floor as most of the take's are."""
    frames = _nearest(take.time, clip.time)
    raw, clean = take.positions[frames].reshape(-1, 3), clip.positions.reshape(-1, 3)
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise InputError(f"{take.source}: holds no joint in the time of the clip")
    tilt, floor = _tilt_and_floor(raw[known], clean[known])
    return leveled(shown, tilt) - [0.0, floor, 0.0]


def _tilt_and_floor(raw: Array, clean: Array) -> tuple[float, float]:
    """Return the tilt [rad] and the floor's height [m] between points (N, 3).

    Least squares of the heights, the tilt in small steps; points that are off by more
    than most were moved by something else.
    """
    tilt, used = 0.0, np.ones(len(raw), dtype=np.bool_)
    for _ in range(_STEPS):
        turned = leveled(raw, tilt)
        rise = clean[:, 1] - turned[:, 1]
        columns = np.stack([-turned[:, 2], np.ones(len(raw))], axis=1)
        step = np.linalg.lstsq(columns[used], rise[used], rcond=None)[0]
        tilt += float(step[0])
        off = np.abs(rise - columns @ step)
        used = off <= 3.0 * np.median(off) + 1e-9
    if abs(tilt) < _LEAST_TILT:
        tilt = 0.0
    turned = leveled(raw, tilt)
    return tilt, float(np.median(turned[:, 1] - clean[:, 1]))


def _nearest(stamps: Array, times: Array) -> NDArray[np.intp]:
    after = np.clip(np.searchsorted(stamps, times), 1, max(len(stamps) - 1, 1))
    after = np.minimum(after, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times - stamps[before] < stamps[after] - times, before, after)
