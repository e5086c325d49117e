"""A raw take in the frame of the clip that was made from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.target.floor import leveled, to_world

_SKEW = 1e-6  # s between the time stamps of a take and of its clip: rounding
_ROUNDING = 1e-3  # m: some takes are kept in whole millimeters
_APART = 0.1  # s, at most, between a frame and the measurement shown for it
_LEAST_TILT = np.radians(1.5)  # a smaller tilt comes from what cleaning moved
_STEPS = 8  # of Newton's method: each squares the error of the angle


def keeps_frame(clip: Clip) -> bool:
    """Return whether a clip says how its take was leveled."""
    return bool(np.isfinite([clip.tilt, clip.floor]).all())


def same_stamps(clip: Clip, take: Take) -> bool:
    """Return whether a clip and a take have frames at the same times."""
    return len(clip) == len(take) and np.allclose(
        clip.time, take.time, rtol=0.0, atol=_SKEW
    )


def nearest_frames(stamps: Array, times: Array) -> NDArray[np.intp]:
    """Return which of some time stamps [s] is nearest to each time, shape (T,)."""
    after = np.clip(np.searchsorted(stamps, times), 1, max(len(stamps) - 1, 1))
    after = np.minimum(after, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(times - stamps[before] < stamps[after] - times, before, after)


def raw_positions(path: Path, clip: Clip, times: Array) -> Array:
    """Read the take of a clip and return its joints in the clip's frame.

    Positions [m] at some times [s], NaN where nothing was measured, shape (T, J, 3).

    Raises:
        InputError: The file is no take, or not the one that the clip was made from.
    """
    take = read_take(path)
    if take.skeleton.name != clip.skeleton.name:
        raise InputError(
            f"--compare {path}: a take of {take.skeleton.name}, but the clip has "
            f"{clip.skeleton.name}; give the take that it was made of"
        )
    nearest = nearest_frames(take.time, times)
    apart = np.abs(take.time[nearest] - times)
    if np.median(apart) > _APART:
        raise InputError(
            f"--compare {path}: from {take.time[0]:.2f} to {take.time[-1]:.2f} s, but "
            f"the clip from {times[0]:.2f} to {times[-1]:.2f} s; give the take that it "
            "was made of"
        )
    try:
        placed = (in_clip_frame if keeps_frame(clip) else leveled_to_clip)(take, clip)
    except InputError as error:
        raise InputError(f"--compare {path}: {error}") from None
    return np.where((apart > _APART)[:, None, None], np.nan, placed[nearest])


def in_clip_frame(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    The take is leveled as cleaning leveled it. Where both have the same frames, the
    distances that the clip keeps show whether it was made from this take.

    Raises:
        InputError: The clip does not keep its tilt and floor, or it was made from
            another take.
    """
    if not keeps_frame(clip):
        raise InputError(
            "the clip does not say where its floor was (older versions of kinefilter "
            "did not keep it); clean the take again"
        )
    positions = to_world(take.positions, clip.tilt, clip.floor)
    if same_stamps(clip, take):
        _check_made_from(clip, positions)
    return positions


def leveled_to_clip(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    For clips that do not keep their tilt and floor (BVH, CSV): both are estimated from
    the heights of the joints.

    Raises:
        InputError: The take has no joints in the time of the clip.
    """
    frames = nearest_frames(take.time, clip.time)
    raw, clean = take.positions[frames].reshape(-1, 3), clip.positions.reshape(-1, 3)
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise InputError("the take holds no joint in the time of the clip")
    return to_world(take.positions, *_tilt_and_floor(raw[known], clean[known]))


def _tilt_and_floor(raw: Array, clean: Array) -> tuple[float, float]:
    """Return the tilt [rad] and the floor's height [m] between points (N, 3).

    Robust least squares of the heights, by Newton's method.
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


def _check_made_from(clip: Clip, measured: Array) -> None:
    """Raise an InputError unless joints (T, J, 3) were measured where a clip says."""
    beyond = _disagreement(clip, measured)
    if np.isnan(beyond).all():
        raise InputError("the take holds no joint that the clip was made of")
    # Where the tracker took left for right, cleaning put them back.
    exchanged = _disagreement(clip, measured[:, clip.skeleton.mirror])
    most = np.minimum(*(np.nan_to_num(b).max(axis=1) for b in (beyond, exchanged)))
    wrong = np.flatnonzero(most > _ROUNDING)
    if len(wrong):
        worst = int(most.argmax())
        joint = clip.skeleton.joints[int(np.nanargmax(beyond[worst]))]
        raise InputError(
            f"in {len(wrong)} of {len(clip)} frames joints are not where the clip says "
            f"that they were measured: {joint} in frame {worst + 1} is "
            f"{most[worst] * 100:.1f} cm or more from there; give the take, and the "
            "person in it, that the clip was made of"
        )


def _disagreement(clip: Clip, measured: Array) -> Array:
    """Return how far joints are from where a clip allows them to be [m], shape (T, J).

    A joint that correction moved by c and then physics by p is c - p to c + p away from
    its measurement. NaN where nothing was measured, and in frames that repeat a time
    stamp, of which only the first was used.
    """
    away = np.linalg.norm(clip.positions - measured, axis=2)
    off = np.abs(away - clip.moved_by_correction)
    off -= np.nan_to_num(clip.moved_by_physics)
    off[1:][np.diff(clip.time) == 0.0] = np.nan
    return np.asarray(off)
