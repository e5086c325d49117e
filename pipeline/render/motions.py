"""The motion that is drawn, whatever file it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError
from kinefilter.pipeline.formats import read_clip
from kinefilter.pipeline.formats.resample import resampled

from .look import Look

_SKEW = 1e-6  # s that a frame may lie outside of --from and --to


def read_motion(path: Path) -> Clip:
    """Read a clip (``read_clip``) that has frames, and only finite numbers.

    Raises:
        InputError: As ``read_clip``, or there is nothing to draw.
    """
    clip = read_clip(path)
    if not len(clip):
        raise InputError(f"{path}: has no frames; nothing can be drawn")
    if not (np.isfinite(clip.positions).all() and np.isfinite(clip.rotations).all()):
        raise InputError(f"{path}: has numbers that are not finite; write it again")
    return clip


def shown_frames(clip: Clip, look: Look) -> tuple[Clip, float]:
    """Return the frames that are drawn and how many of them a second has.

    Frames lie evenly in time, whatever the sensor did.

    Raises:
        InputError: The clip has none between --from and --to.
    """
    rate = look.fps or clip.fps
    even = resampled(clip, rate)
    since = even.time - even.time[0]
    end = np.inf if look.to is None else look.to
    chosen = np.flatnonzero((since >= look.start - _SKEW) & (since <= end + _SKEW))
    if not len(chosen):
        raise InputError(
            f"{clip.source}: has no frame from {look.start:g} s"
            + (f" to {look.to:g} s" if look.to is not None else "")
            + f"; it lasts {since[-1]:.2f} s"
        )
    return even.at(chosen[:: look.every]), rate / look.every
