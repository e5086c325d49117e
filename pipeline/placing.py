"""A take where its clip is: leveled and on the floor, as cleaning did it.

A clip does not keep by how much; what it keeps says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kinefilter.characters import Clip, InputError, Take

from .target.floor import leveled

__all__ = [
    "nearest_frames",
    "placed_by_distances",
    "placed_by_heights",
    "same_stamps",
]

Array = NDArray[np.float64]

_POINTS = 6000  # measured joints that are fitted, of all: two unknowns need no more
_SCATTER = 1e-3  # m: what rounding in files may do
_LEAST_TILT = np.radians(1.5)  # below, it is what cleaning moved
_STEPS = 8  # each leaves the square of the angle before
_SKEW = 1e-3  # s between the time stamps of a take and of its clip: rounding
_OFF = 0.01  # m: farther than physics explains, and the take is another one. A guess.


def placed_by_distances(clip: Clip, take: Take) -> Array:
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

    # Distances alone have a second minimum here and there; heights know the way.
    starts = (
        (0.0, float(np.median(raw[:, 1] - clean[:, 1]))),
        _tilt_and_floor(raw, clean),
    )
    fits = [
        least_squares(weighted, start, loss="soft_l1", x_scale=[0.1, 0.1])  # rad, m
        for start in starts
    ]
    fit = min(fits, key=lambda fit: float(fit.cost))
    beyond = np.abs(off(fit.x)) - slack
    if np.median(beyond) > _OFF:
        raise InputError(
            f"half of the joints are {np.median(beyond) * 100:.0f} cm or more from "
            "where the clip says; give the take that the clip was made of"
        )
    return leveled(take.positions, float(fit.x[0])) - [0.0, float(fit.x[1]), 0.0]


def placed_by_heights(clip: Clip, take: Take) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    For clips that keep no distances, or have other frames: what cleaning did shows in
    where most joints are.

    Args:
        clip: What was made of the take.
        take: Of the same skeleton.

    Raises:
        InputError: The take holds nothing in the time of the clip.
    """
    frames = nearest_frames(take.time, clip.time)
    raw, clean = take.positions[frames].reshape(-1, 3), clip.positions.reshape(-1, 3)
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise InputError(f"{take.source}: holds no joint in the time of the clip")
    tilt, floor = _tilt_and_floor(raw[known], clean[known])
    return leveled(take.positions, tilt) - [0.0, floor, 0.0]


def same_stamps(clip: Clip, take: Take) -> bool:
    """Return whether a clip has a frame for each of a take, at the same times."""
    return len(clip) == len(take) and np.allclose(
        clip.time, take.time, rtol=0.0, atol=_SKEW
    )


def nearest_frames(stamps: Array, times: Array) -> NDArray[np.intp]:
    """Return which of some time stamps [s] is nearest to each time, shape (T,)."""
    after = np.clip(np.searchsorted(stamps, times), 1, max(len(stamps) - 1, 1))
    after = np.minimum(after, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times - stamps[before] < stamps[after] - times, before, after)


def _tilt_and_floor(raw: Array, clean: Array) -> tuple[float, float]:
    """Return the tilt [rad] and the floor's height [m] between points (N, 3).

    Least squares of the heights, the tilt in small steps; points that are off by more
    than most were moved by something else.
    """
    tilt, used = 0.0, np.ones(len(raw), dtype=np.bool_)
    for _ in range(_STEPS):
        turned = leveled(raw, tilt)
        rise = clean[:, 1] - turned[:, 1]
        columns = np.stack([-turned[:, 2], np.ones(len(raw))], axis=1)
        step = np.linalg.lstsq(columns[used], rise[used], rcond=None)[0]
        tilt += float(step[0])
        off = np.abs(rise - columns @ step)
        used = off <= 3.0 * np.median(off) + 1e-9
    if abs(tilt) < _LEAST_TILT:
        tilt = 0.0
    turned = leveled(raw, tilt)
    return tilt, float(np.median(turned[:, 1] - clean[:, 1]))
