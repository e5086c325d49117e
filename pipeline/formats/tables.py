"""Motion as a CSV table: kinefilter's own layout."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Origin, State, Take

from .files import atomic_path

__all__ = ["write_take_csv"]

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
    joints = motion.skeleton.joints
    row = ",".join(["%r", *["%.9f,%.9f,%.9f,%d"] * len(joints)]) + "\n"
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        columns = (f"{j}.{part}" for j in joints for part in ("x", "y", "z", "state"))
        file.write(",".join(["time", *columns]) + "\n")
        for start in range(0, len(motion), _FRAMES_AT_ONCE):
            numbers = _numbers(motion, slice(start, start + _FRAMES_AT_ONCE))
            text = row * len(numbers) % tuple(numbers.ravel().tolist())
            file.write(text.replace("nan", ""))


def _numbers(motion: Take | Clip, frames: slice) -> NDArray[np.float64]:
    """Return the rows of some frames, shape (T, 1 + 4 J)."""
    time, state = motion.time[frames], motion.state[frames]
    if isinstance(motion, Clip):
        # What the sensor did not see has a place now, but only inferred.
        measured = motion.origin[frames] == Origin.MEASURED
        state = np.where(measured, np.maximum(state, State.INFERRED), State.INFERRED)
    joints = np.concatenate([motion.positions[frames], state[..., None]], axis=-1)
    return np.concatenate([time[:, None], joints.reshape(len(time), -1)], axis=1)
