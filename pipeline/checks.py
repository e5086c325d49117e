"""Checks of the frames and takes that are given to the cleaner."""

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, as_numbers, check_kind, shown

from .formats.recording import check_extent, check_rate, far_joints

_NEEDED = 600  # bytes per joint and frame while cleaning with physics
_LARGE = 2**29  # bytes; less is assumed to be free
_FARTHEST = 1e8  # m; farther joints are missing, so that squares do not overflow


def checked_frame(
    positions: ArrayLike, state: ArrayLike | None, skeleton: Skeleton
) -> tuple[Array, Codes]:
    """Return positions (J, 3) and states (J,) of a frame, or raise an InputError.

    Positions are NaN, and states 0, where missing, not tracked or too far away.
    """
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


def checked_take(take: Take) -> Take:
    """Return a take without damaged joints, or raise InputError if none can be cleaned.

    It is refused, too, if the memory is too small for it.
    """
    check_kind(take, Take, "the take")
    take = take.without(far_joints(take.positions))
    check_extent(take.positions, take.source)
    check_rate(take.time, take.source)
    if take.time[-1] <= take.time[0]:
        raise InputError(f"{take.source}: one distinct time stamp; a motion needs two")
    needed = take.state.size * _NEEDED
    if needed < _LARGE:
        return take
    import psutil  # only needed here

    free = psutil.virtual_memory().available
    if needed > free:
        raise InputError(
            f"{take.source}: {len(take)} frames need about {needed / 1e9:.1f} GB of "
            f"memory, but {free / 1e9:.1f} GB are free; cut the take into parts"
        )
    return take
