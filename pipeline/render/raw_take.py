"""The raw take of a clip, where the clip's character is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Take
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.placing import (
    nearest_frames,
    placed_by_distances,
    placed_by_heights,
    same_stamps,
)

__all__ = ["raw_positions"]

Array = NDArray[np.float64]

_APART = 0.1  # s between a frame and the measurement shown for it, at most


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
    keeps = _keeps_distances(clip, take)
    try:
        placed = (placed_by_distances if keeps else placed_by_heights)(clip, take)
    except InputError as error:
        raise InputError(f"--compare {path}: {error}") from None
    away = np.abs(take.time[nearest] - times) > _APART
    return np.where(away[:, None, None], np.nan, placed[nearest])


def _keeps_distances(clip: Clip, take: Take) -> bool:
    """Tell whether a clip says how far each joint of the take was moved."""
    return same_stamps(clip, take) and bool(np.isfinite(clip.moved_by_correction).any())
