"""What a clip shows where a character was lost before it was reset onto its target.

Lost limbs thrash, and jump when the character is put back. The clip shows the target
instead: it may be a posture that no body can take, but it moves as the sensor saw it.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Body, positions_from_rotations
from kinefilter.characters.arrays import Array, Indices
from kinefilter.characters.rotations import slerp
from kinefilter.pipeline.target.floor import clearances, floor_penetration

# Guesses.
_FOLLOWED = 0.1  # m of a joint from its target, up to which it follows
_LONGEST_LOST = 1.0  # s
_BLENDING_TIME = 0.2  # s before, in which the pose goes to its target


def bridge_resets(
    time: Array,
    pose: tuple[Array, Array],
    target: tuple[Array, Array],
    resets: Indices,
    body: Body,
) -> None:
    """Blend the pose into the target before each reset, so that nothing jumps.

    Pose, which is changed, and target are rotations, wxyz, (T, J, 4), and positions of
    the root [m], (T, 3), at each time stamp [s]. ``resets`` are frames of resets.
    """
    # Between resets in a row there is nothing to blend.
    for stop in resets[np.diff(resets, prepend=-2) > 1]:
        earliest = time[stop] - _LONGEST_LOST
        start = int(np.searchsorted(time, earliest - _BLENDING_TIME))
        before = slice(start, int(stop))
        (turns, roots), (wanted, there) = (
            (rotations[before], root[before]) for rotations, root in (pose, target)
        )
        away = positions_from_rotations(turns, roots, body)
        away -= positions_from_rotations(wanted, there, body)
        follows = (np.linalg.norm(away, axis=-1) < _FOLLOWED).all(axis=-1)
        # A limb that comes back only for a moment does not follow.
        now = time[before]
        left = np.maximum.accumulate(np.where(follows, -np.inf, now))
        lost = max([earliest, *now[now - left > _BLENDING_TIME][-1:]])
        share = np.clip(1.0 + (now - lost) / _BLENDING_TIME, 0.0, 1.0)
        turns[:] = slerp(turns, wanted, share[:, None])
        roots += share[:, None] * (there - roots)
        heights = positions_from_rotations(turns, roots, body)[..., 1]
        roots[:, 1] += floor_penetration(heights, clearances(body))
