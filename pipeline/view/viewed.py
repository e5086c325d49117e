"""What is looked at: a clip, and what it was before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kinefilter.characters import Clip, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Viewed:
    """A clip with what there is beside it, all in the clip's frame."""

    clip: Clip
    """The motion."""
    raw: Array | None = None
    """Measured joint positions [m], NaN: missing, shape (T, J, 3)."""
    target: Array | None = None
    """Joint positions [m] before physics, shape (T, J, 3)."""


def read_viewed(
    clip_path: Path, take_path: Path | None = None, *, body: int | None = None
) -> Viewed:
    """Read a clip, and the take that it was made of if it is given.

    Args:
        clip_path: The clip, npz.
        take_path: The take.
        body: Whose, counted from 1; None: who is seen in most frames.

    Raises:
        InputError: One cannot be read, or they do not belong together.
    """
    if take_path is None:
        from kinefilter.pipeline.render.motions import read_motion

        return Viewed(read_motion(clip_path))
    from kinefilter.pipeline.report import read_compared

    compared = read_compared(clip_path, take_path, body=body)
    return Viewed(compared.clip, compared.raw)


def cleaned(take: Take, config: CleanConfig, *, progress: Progress = silent) -> Viewed:
    """Clean a take and keep what it was on the way.

    Raises:
        InputError: As ``clean``.
    """
    from kinefilter.pipeline.cleaner import clean
    from kinefilter.pipeline.target.floor import to_world

    result = clean(take, config, progress=progress)
    target = result.target if config.physics else None
    clip = result.clip
    return Viewed(clip, to_world(take.positions, clip.tilt, clip.floor), target)
