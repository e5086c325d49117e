"""What is drawn: a clip, and its motion before correction and before physics.

Videos, the viewer and the report page all draw a ``Drawing``, each in its own medium.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError, Motion, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import rotate
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats import read_clip
from kinefilter.pipeline.progress import Progress, silent

from .figures import StickFigure

CLEANED, PHYSICS = (0.36, 0.27, 0.72), (0.93, 0.47, 0.13)
"""Colors of the stick figures before and after physics."""

_HIDDEN = ("cleaned", "physics")  # at first: the skin shows where they are
_GAP = 0.35  # m between the raw figure and the character, a guess by eye
_FORCE_ASIDE = 0.55  # m from the pelvis to the bar of the external force


@dataclass(frozen=True, eq=False)
class Drawing:
    """A clip and what it was made from, in the clip's frame."""

    clip: Clip
    """The motion, with its props, contacts and external force."""
    raw: Array | None = None
    """Measured joint positions [m], NaN where missing, shape (T, J, 3)."""
    target: Array | None = None
    """Joint positions [m] before physics, shape (T, J, 3)."""

    @property
    def simulated(self) -> bool:
        """Whether the clip went through physics."""
        return bool(np.isfinite(self.clip.external_force).any())

    @cached_property
    def figures(self) -> dict[str, StickFigure]:
        """The stick figures by name: raw, cleaned (before physics) and physics."""
        clip = self.clip
        found = {}
        if self.raw is not None:
            found["raw"] = StickFigure(
                clip.skeleton, self.raw, reliability=clip.reliability
            )
        before = self.target if self.simulated else clip.positions
        if before is not None:
            found["cleaned"] = StickFigure(clip.skeleton, before, CLEANED)
        if self.simulated:
            found["physics"] = StickFigure(clip.skeleton, clip.positions, PHYSICS)
        return found

    @property
    def layers(self) -> dict[str, bool]:
        """What there is to show, by name, and whether it is shown at first."""
        names = ["skin", *self.figures, "contacts"]
        names += ["forces"] if self.simulated else []
        names += ["things"] if self.clip.props else []
        return {name: name not in _HIDDEN for name in names}

    @property
    def raw_offset(self) -> Array:
        """Offset [m] to the character's right that separates raw and clip, (3,).

        Seen from the front that is the picture's left.
        """
        if self.raw is None:
            return np.zeros(3)
        return offset_beside(self.clip.positions, -left_of(self.clip))

    @property
    def force_places(self) -> Array:
        """Where the bar of the external force stands on the floor [m], shape (T, 3)."""
        return self.clip.root * [1.0, 0.0, 1.0] + _FORCE_ASIDE * left_of(self.clip)


def offset_beside(positions: Array, way: Array, room: float = 0.0) -> Array:
    """Return the offset [m] along a unit vector that separates two figures, (3,)."""
    width = np.ptp(positions @ way, axis=1).max()
    return np.asarray((width + _GAP + room) * way)


def left_of(motion: Motion) -> Array:
    """Return the character's mean left, a level unit vector, shape (3,)."""
    turns = motion.rotations[:, motion.skeleton.root]
    left = rotate(turns, np.array([1.0, 0.0, 0.0])).mean(axis=0) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(left))
    # Somebody who turned all the way around has no mean left.
    return np.asarray(left / length) if length > 0.1 else np.array([1.0, 0.0, 0.0])


def cleaned(take: Take, config: CleanConfig, *, progress: Progress = silent) -> Drawing:
    """Clean a take and keep its motion before correction and before physics.

    Raises:
        InputError: As ``clean``.
    """
    from kinefilter.pipeline.cleaner import clean
    from kinefilter.pipeline.target.floor import to_world

    result = clean(take, config, progress=progress)
    target = result.target if config.physics else None
    clip = result.clip
    return Drawing(clip, to_world(take.positions, clip.tilt, clip.floor), target)


def read_finite_clip(path: Path) -> Clip:
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
