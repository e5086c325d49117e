"""A take in the frame of the clip that was made of it."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Clip, InputError, Take
from kinefilter.characters.arrays import Array

from .target.floor import to_world

_SKEW = 1e-6  # s between the time stamps of a take and of its clip: rounding
_ROUNDING = 1e-3  # m: takes are kept in whole millimeters too


def keeps_frame(clip: Clip) -> bool:
    """Return whether a clip says what was done to its take."""
    return bool(np.isfinite([clip.tilt, clip.floor]).all())


def in_clip_frame(take: Take, clip: Clip) -> Array:
    """Return joint positions [m] of a take in its clip's frame, shape (T, J, 3).

    What cleaning did is done again. Where the two have the same frames, the clip also
    says how far each joint was moved, which only its own take agrees with.

    Args:
        take: Of the clip's skeleton.
        clip: What was made of it.

    Raises:
        InputError: The clip does not say, or it was made of another take.
    """
    if not keeps_frame(clip):
        raise InputError(
            "the clip does not say where its floor was (older versions of kinefilter "
            "did not keep it); clean the take again"
        )
    positions = to_world(take.positions, clip.tilt, clip.floor)
    if same_stamps(clip, take):
        _check_made_of(clip, positions)
    return positions


def same_stamps(clip: Clip, take: Take) -> bool:
    """Return whether a clip has a frame for each of a take, at the same times."""
    return len(clip) == len(take) and np.allclose(
        clip.time, take.time, rtol=0.0, atol=_SKEW
    )


def _check_made_of(clip: Clip, measured: Array) -> None:
    """Raise an InputError unless joints were measured where a clip says, (T, J, 3)."""
    beyond = _beyond(clip, measured)
    if np.isnan(beyond).all():
        raise InputError("the take holds no joint that the clip was made of")
    # Where the tracker took left for right, cleaning put them back.
    exchanged = _beyond(clip, measured[:, clip.skeleton.mirror])
    most = np.minimum(_most(beyond), _most(exchanged))
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


def _beyond(clip: Clip, measured: Array) -> Array:
    """Return by how much joints disagree with a clip [m], shape (T, J).

    A joint that correction moved by c and physics then by p is c - p to c + p away from
    its measurement. NaN where nothing was measured, and in frames that repeat a time
    stamp: the first of them made the clip's.
    """
    away = np.linalg.norm(clip.positions - measured, axis=2)
    off = np.abs(away - clip.moved_by_correction)
    off -= np.nan_to_num(clip.moved_by_physics)
    off[1:][np.diff(clip.time) == 0.0] = np.nan
    return np.asarray(off)


def _most(values: Array) -> Array:
    """Return the largest value of each row, 0 where all are less or NaN."""
    return np.asarray(np.nan_to_num(values).max(axis=1).clip(min=0.0))
