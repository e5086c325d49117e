"""The raw take of a clip, where the clip's character is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.clip_frame import in_clip_frame, keeps_frame
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.target.floor import leveled, to_world

_APART = 0.1  # s between a frame and the measurement shown for it, at most
_LEAST_TILT = np.radians(1.5)  # below, it is what cleaning moved
_STEPS = 8  # each leaves the square of the angle before


def raw_positions(path: Path, clip: Clip, times: Array) -> Array:
    """Return where the take of a clip has the joints, in the clip's frame.

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
    nearest = nearest_frames(take.time, times)
    if np.median(np.abs(take.time[nearest] - times)) > _APART:
        raise InputError(
            f"--compare {path}: from {take.time[0]:.2f} to {take.time[-1]:.2f} s, but "
            f"the clip from {times[0]:.2f} to {times[-1]:.2f} s; give the take that it "
            "was made of"
        )
    try:
        placed = (in_clip_frame if keeps_frame(clip) else _by_heights)(take, clip)
    except InputError as error:
        raise InputError(f"--compare {path}: {error}") from None
    away = np.abs(take.time[nearest] - times) > _APART
    return np.where(away[:, None, None], np.nan, placed[nearest])


def nearest_frames(stamps: Array, times: Array) -> NDArray[np.intp]:
    """Return which of some time stamps [s] is nearest to each time, shape (T,)."""
    after = np.clip(np.searchsorted(stamps, times), 1, max(len(stamps) - 1, 1))
    after = np.minimum(after, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times - stamps[before] < stamps[after] - times, before, after)


def _by_heights(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    For clips of files that do not say what cleaning did (BVH, CSV): it shows in where
    most joints are.

    Raises:
        InputError: The take holds nothing in the time of the clip.
    """
    frames = nearest_frames(take.time, clip.time)
    raw, clean = take.positions[frames].reshape(-1, 3), clip.positions.reshape(-1, 3)
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise InputError("the take holds no joint in the time of the clip")
    return to_world(take.positions, *_tilt_and_floor(raw[known], clean[known]))


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
