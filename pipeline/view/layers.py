"""All that can be shown of what is looked at, by name."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import rotate

from .figures import Layer, SkinFigure, StickFigure, Things
from .marks import FootMarks, ForceBar
from .viewed import Viewed

_HIDDEN = ("cleaned", "physics")  # at first: the skin shows where they are
_CLEANED, _PHYSICS = (0.36, 0.27, 0.72), (0.93, 0.47, 0.13)  # colors of their bones
_BETWEEN = 0.35  # m from the raw take to the character


def names_of(viewed: Viewed) -> dict[str, bool]:
    """Return what there is to show, and whether it is shown at first."""
    clip, simulated = viewed.clip, _simulated(viewed.clip)
    there = {
        "skin": True,
        "raw": viewed.raw is not None,
        "cleaned": viewed.target is not None or not simulated,
        "physics": simulated,
        "contacts": True,
        "forces": simulated,
        "things": bool(clip.props),
    }
    return {name: name not in _HIDDEN for name, is_there in there.items() if is_there}


def way_aside(viewed: Viewed) -> Array:
    """Return the way [m] to the character's right that keeps its take apart from it.

    From the front that is the picture's left.
    """
    if viewed.raw is None:
        return np.zeros(3)
    clip = viewed.clip
    right = -_left(clip)
    width = np.ptp(clip.positions @ right, axis=1).max()
    return np.asarray((width + _BETWEEN) * right)


class Layers:
    """What is drawn in a scene, moved together.

    Args:
        scene: Where.
        viewed: What is looked at.
        contacts: When feet stand, shape (T, 4).
    """

    def __init__(
        self, scene: viser.SceneApi, viewed: Viewed, contacts: NDArray[np.bool_]
    ) -> None:
        clip, skeleton = viewed.clip, viewed.clip.skeleton
        self._skin = SkinFigure(scene, clip)
        self._marks = FootMarks(scene, clip, contacts)
        self._raw: StickFigure | None = None
        self._all: dict[str, Layer] = {"skin": self._skin, "contacts": self._marks}
        if viewed.raw is not None:
            self._raw = StickFigure(
                scene, "raw", skeleton, viewed.raw, reliability=clip.reliability
            )
            self._all["raw"] = self._raw
        simulated = _simulated(clip)
        before = viewed.target if simulated else clip.positions
        if before is not None:
            self._all["cleaned"] = StickFigure(
                scene, "cleaned", skeleton, before, color=_CLEANED
            )
        if simulated:
            self._all["physics"] = StickFigure(
                scene, "physics", skeleton, clip.positions, color=_PHYSICS
            )
            self._all["forces"] = ForceBar(scene, clip, _left(clip))
        if clip.props:
            self._all["things"] = Things(scene, clip.props)
        self._shown = set(self._all)

    def choose(self, names: set[str], aside: Array) -> None:
        """Show these and hide the others.

        Args:
            names: What is to be seen.
            aside: How far [m] from the character the raw take stands, shape (3,).
        """
        for name, layer in self._all.items():
            layer.set_visible(name in names)
        self._shown = names & set(self._all)
        if self._raw is not None:
            self._raw.move(aside)
        inside = {"cleaned", "physics"} | (set() if aside.any() else {"raw"})
        self._skin.set_translucent(bool(self._shown & inside))

    def mark(self, contacts: NDArray[np.bool_]) -> None:
        """Take other contacts, shape (T, 4)."""
        self._marks.contacts = contacts

    def show(self, frame: int) -> None:
        """Put all that is seen where it is in a frame."""
        for name in self._shown:
            self._all[name].show(frame)


def _simulated(clip: Clip) -> bool:
    return bool(np.isfinite(clip.external_force).any())


def _left(clip: Clip) -> Array:
    """Return the character's left on the whole, a level unit vector, shape (3,)."""
    turns = clip.rotations[:, clip.skeleton.root]
    left = rotate(turns, np.array([1.0, 0.0, 0.0])).mean(axis=0) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(left))
    # Who turned all around has no left on the whole.
    return np.asarray(left / length) if length > 0.1 else np.array([1.0, 0.0, 0.0])
