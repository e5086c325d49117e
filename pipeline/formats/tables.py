"""Motion as a CSV table: kinefilter's own layout."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Origin, Skeleton, State, Take
from kinefilter.characters.arrays import Array

from .files import atomic_path

_FRAMES_AT_ONCE = 1000  # about a megabyte of text


def write_take_csv(motion: Take | Clip, path: str | os.PathLike[str]) -> None:
    """Write time [s], joint positions [m] and states, one row per frame.

    The header is ``time,Joint.x,Joint.y,Joint.z,Joint.state,...`` with the joints in
    the sensor's order. In a clip, the state of a joint that was not measured as it is
    is inferred. Positions have nine decimals, time as many as it needs to read
    back the same; a missing coordinate is an empty cell.

    Raises:
        InputError: The file cannot be written.
    """
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write(take_header(motion.skeleton))
        for start in range(0, len(motion), _FRAMES_AT_ONCE):
            frames = slice(start, start + _FRAMES_AT_ONCE)
            state = _states(motion, frames)
            file.write(take_rows(motion.time[frames], motion.positions[frames], state))


def take_header(skeleton: Skeleton) -> str:
    """Return the line of the columns' names."""
    parts = ("x", "y", "z", "state")
    columns = (f"{joint}.{part}" for joint in skeleton.joints for part in parts)
    return ",".join(["time", *columns]) + "\n"


def take_rows(time: Array, positions: Array, state: NDArray[np.uint8]) -> str:
    """Return the lines of some frames.

    Args:
        time: Time stamps [s], shape (T,).
        positions: Joint positions [m], NaN where missing, shape (T, J, 3).
        state: Tracking states (State), shape (T, J).
    """
    count, joints = state.shape
    row = ",".join(["%r", *["%.9f,%.9f,%.9f,%d"] * joints]) + "\n"
    each = np.concatenate([positions, state[..., None]], axis=-1)
    numbers = np.concatenate([time[:, None], each.reshape(count, -1)], axis=1)
    text: str = row * count % tuple(numbers.ravel().tolist())
    return text.replace("nan", "")


def _states(motion: Take | Clip, frames: slice) -> NDArray[np.uint8]:
    """Return the states of some frames, shape (T, J)."""
    state = motion.state[frames]
    if isinstance(motion, Clip):
        # What the sensor did not see has a place now, but only inferred.
        measured = motion.origin[frames] == Origin.MEASURED
        state = np.where(measured, np.maximum(state, State.INFERRED), State.INFERRED)
    return state
