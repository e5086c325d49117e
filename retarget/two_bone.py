"""Where the middle of a limb is when its end has to be somewhere: closed form."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

_TINY = 1e-9  # m


def bent_limb(
    start: Array, goal: Array, toward: Array, lengths: Array
) -> tuple[Array, Array]:
    """Return where middle and end of a limb of two bones are.

    The law of cosines says how far along the line to the goal the middle is, and how
    far aside. A goal out of reach is approached as far as the bones go.

    Args:
        start: Where the limb begins [m], shape (..., 3).
        goal: Where it should end [m], shape (..., 3).
        toward: Direction to which the middle bends, of any length but not along the
            limb, shape (..., 3).
        lengths: Lengths of the two bones [m], shape (2,).

    Returns:
        Middle and end [m], each of shape (..., 3).
    """
    first, second = lengths
    line = goal - start
    asked = np.linalg.norm(line, axis=-1, keepdims=True)
    along = line / np.maximum(asked, _TINY)
    reach = np.clip(asked, max(abs(first - second), _TINY), first + second)
    share = (reach**2 + first**2 - second**2) / (2.0 * reach)
    aside = np.sqrt(np.maximum(first**2 - share**2, 0.0))
    across = toward - np.sum(toward * along, axis=-1, keepdims=True) * along
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), _TINY)
    return start + share * along + aside * across, start + reach * along
