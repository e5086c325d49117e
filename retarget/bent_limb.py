"""Where elbow and knee are, given both ends of a limb."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit

_SHORT = 1e-9  # m


def bent_limb(
    start: Array,
    goal: Array,
    toward: Array,
    lengths: ArrayLike,
    reach: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """Return where middle and end [m] of a limb of two bones are, in closed form.

    The law of cosines says how far along the line to the goal the middle is, and how
    far aside. A goal out of reach, by default that of the bones, is approached as far
    as it goes. ``toward`` is the direction to which the middle bends, of any length but
    not along the limb; points are (..., 3), lengths and reach [m] (2,).
    """
    first, second = np.asarray(lengths, dtype=float)
    least, most = reach or (max(abs(first - second), _SHORT), first + second)
    line = goal - start
    asked = np.linalg.norm(line, axis=-1, keepdims=True)
    ahead = line / np.maximum(asked, _SHORT)
    far = np.clip(asked, least, most)
    along = (first**2 - second**2 + far**2) / (2.0 * far)
    aside = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    across = unit(toward - np.sum(toward * ahead, axis=-1, keepdims=True) * ahead)
    return start + along * ahead + aside * across, start + far * ahead
