"""What the cleaner takes in: frames and takes, checked before anything is done."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, as_numbers, check_kind, shown

from .formats.recording import check_extent, check_rate

_NEEDED = 600  # bytes that a joint of a frame costs while it is cleaned, with physics
_LARGE = 2**29  # bytes that are there without asking
_FARTHEST = 1e8  # m: whatever the sensor means by it, squares must not overflow


def checked_frame(
    positions: ArrayLike, state: ArrayLike | None, skeleton: Skeleton
) -> tuple[Array, Codes]:
    """Return positions (J, 3), NaN if missing, not tracked or too far, states (J,)."""
    what, count = f"a frame of {skeleton.name}", len(skeleton)
    seen = as_numbers(positions, what, (count, 3), ", the joints in the SDK's order")
    seen = seen.astype(float)
    near = (np.abs(seen) < _FARTHEST).all(axis=1)  # False for NaN, too
    states = np.full(count, State.TRACKED, dtype=np.uint8)
    if state is not None:
        known = as_numbers(state, f"the states of {what}", (count,))
        if not ((known == 0) | (known == 1) | (known == 2)).all():
            raise InputError(f"the states of {what} are {shown(state)}; give 0, 1 or 2")
        states = known.astype(np.uint8)
        near &= states > State.NOT_TRACKED
    return np.where(near[:, None], seen, np.nan), np.where(near, states, np.uint8(0))


def check_take(take: Take) -> None:
    """Raise InputError for what is no take, or one that holds nothing to clean."""
    check_kind(take, Take, "the take")
    check_extent(take.positions, take.source)
    check_rate(take.time, take.source)
    if take.time[-1] <= take.time[0]:
        raise InputError(
            f"{take.source}: the take has one distinct time stamp; "
            "a motion needs two frames or more"
        )
    _check_memory(take)


def _check_memory(take: Take) -> None:
    """Raise InputError for a take for which the memory does not suffice."""
    needed = take.state.size * _NEEDED
    if needed < _LARGE:
        return
    import psutil  # only here is it needed

    free = psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"{take.source}: cleaning {len(take)} frames needs about "
            f"{needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free; cut "
            "the take into parts"
        )
