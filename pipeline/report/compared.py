"""A clip beside the take it was made of, in the same frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.clip_frame import in_clip_frame, same_stamps
from kinefilter.pipeline.formats import read_clip, read_take
from kinefilter.pipeline.formats.files import check_file
from kinefilter.pipeline.metrics import measure
from kinefilter.pipeline.target.feet import feet_of

from .table import figures_of

_TRY = "give the take that the clip was made of"
_FARTHEST = 1e3  # m from the origin: no sensor and no hall is as large


@dataclass(frozen=True, eq=False)
class Compared:
    """A clip, and its measurement where the clip's character is."""

    clip: Clip
    """What was made of the take."""
    raw: Array
    """Measured joint positions [m], the clip's frame, NaN: missing, (T, J, 3)."""
    before: dict[str, float]
    """Metrics of the measurement, by their name in ``METRICS``."""
    after: dict[str, float]
    """Metrics of the clip."""


def read_compared(
    clip_path: Path, take_path: Path, *, body: int | None = None
) -> Compared:
    """Read a clip and its take.

    Args:
        clip_path: The clip, npz.
        take_path: The take.
        body: Whose, counted from 1; None: who is seen in most frames.

    Raises:
        InputError: One cannot be read, or they do not belong together.
    """
    check_file(clip_path)
    if clip_path.suffix.lower() != ".npz":
        raise InputError(
            f"{clip_path}: report reads .npz, which holds all of a clip; write the "
            "clip as .npz too"
        )
    clip, take = read_clip(clip_path), read_take(take_path, body=body)
    try:
        return compare(clip, take)
    except InputError as error:
        raise InputError(f"{clip_path} with --take {take_path}: {error}") from None


def compare(clip: Clip, take: Take) -> Compared:
    """Put a take where its clip is and measure both.

    Feet stand where the clip has contacts, for both. Repeated time stamps count once.

    Raises:
        InputError: The clip was not made of the take, or does not say where its floor
            was, or has numbers that are not finite, or too few frames to be a motion.
    """
    _check(clip, take)
    raw = in_clip_frame(take, clip)
    distinct = np.concatenate([[True], np.diff(clip.time) > 0])
    time, stands = clip.time[distinct], feet_of(clip.contacts)[distinct]
    seen, positions = raw[distinct], clip.positions[distinct]
    before = measure(time, seen, seen, clip.body, stands)
    after = measure(time, positions, seen, clip.body, stands)
    return Compared(clip, raw, figures_of(before), figures_of(after))


def _check(clip: Clip, take: Take) -> None:
    if clip.skeleton != take.skeleton:
        raise InputError(
            f"the clip is of {clip.skeleton.name}, the take of {take.skeleton.name}; "
            f"{_TRY}"
        )
    if len(clip) != len(take):
        raise InputError(
            f"the clip has {len(clip)} frames, the take {len(take)}; {_TRY} (and "
            "without --fps)"
        )
    if len(clip) < 2 or clip.time[-1] <= clip.time[0]:
        raise InputError("a motion needs two frames or more at different times")
    same_time = same_stamps(clip, take)
    if not same_time or not np.array_equal(clip.state, take.state):
        what = "tracking states" if same_time else "time stamps"
        fps = "" if same_time else " (and without --fps)"
        raise InputError(f"the {what} of clip and take differ; {_TRY}{fps}")
    if not np.isfinite(clip.positions).all() or not np.isfinite(clip.reliability).all():
        raise InputError("the clip has numbers that are not finite; write it again")
    for name, positions in (("clip", clip.positions), ("take", take.positions)):
        if (np.abs(positions) > _FARTHEST).any():
            raise InputError(f"the {name} has joints over {_FARTHEST:g} m away; {_TRY}")
