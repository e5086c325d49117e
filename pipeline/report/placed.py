"""A take where its clip is: leveled and on the floor, as cleaning did it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kinefilter.characters import Clip, InputError, Take
from kinefilter.pipeline.floor import leveled

__all__ = ["placed_as"]

Array = NDArray[np.float64]

_POINTS = 6000  # measured joints that are fitted, of all: two unknowns need no more
_SCATTER = 1e-3  # m: what rounding in files may do
_OFF = 0.01  # m: farther than physics explains, and the take is another one. A guess.


def placed_as(clip: Clip, take: Take) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    A clip keeps how far each joint was moved from where it was measured, so the tilt
    of the sensor and the height of its floor are those that give these distances, up
    to what physics moved. Robust least squares: in some frames sides were exchanged.

    Args:
        clip: What was made of the take.
        take: As many frames of the same skeleton.

    Raises:
        InputError: No tilt and height give these distances: it is another take.
    """
    measured = np.isfinite(take.positions).all(axis=2)
    known = np.argwhere(measured & np.isfinite(clip.moved_by_correction))
    if not len(known):
        raise InputError("the take holds no joint that the clip was made of")
    spread = np.linspace(0, len(known) - 1, min(len(known), _POINTS)).astype(np.intp)
    at = tuple(known[spread].T)
    raw, clean = take.positions[at], clip.positions[at]
    moved = clip.moved_by_correction[at]
    slack = np.nan_to_num(clip.moved_by_physics[at])

    def off(placing: Array) -> Array:
        away = clean - (leveled(raw, float(placing[0])) - [0.0, placing[1], 0.0])
        return np.asarray(np.linalg.norm(away, axis=1) - moved)

    def weighted(placing: Array) -> Array:
        return np.asarray(off(placing) / (_SCATTER + slack))

    fit = least_squares(
        weighted,
        [0.0, float(np.median(raw[:, 1] - clean[:, 1]))],
        loss="soft_l1",
        x_scale=[0.1, 0.1],  # rad, m
    )
    beyond = np.abs(off(fit.x)) - slack
    if np.median(beyond) > _OFF:
        raise InputError(
            f"half of the joints are {np.median(beyond) * 100:.0f} cm or more from "
            "where the clip says; give the take that the clip was made of"
        )
    return leveled(take.positions, float(fit.x[0])) - [0.0, float(fit.x[1]), 0.0]
