"""Limbs that were lost before a character was reset onto its target.

They thrash until then, and jump when the character is put back. In the clip they go
straight from where they still followed to where they are after the reset. Their target
cannot replace them: often it is a posture that no body has, and what they were lost to.
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
_BLENDING_TIME = 0.2  # s before, in which the rest of the body goes to its target


def bridge_resets(
    time: Array,
    pose: tuple[Array, Array],
    target: tuple[Array, Array],
    resets: Indices,
    body: Body,
) -> None:
    """Change the pose before each reset so that nothing thrashes or jumps.

    Pose and target are rotations, wxyz, (T, J, 4), and positions of the root [m],
    (T, 3), at each time stamp [s]. ``resets`` are frames in which they are the same.
    """
    skeleton, standing = body.skeleton, clearances(body)
    for stop in resets:
        earliest = time[stop] - _LONGEST_LOST
        start = int(np.searchsorted(time, earliest - _BLENDING_TIME))
        (turns, roots), (wanted, there) = (
            (rotations[start:stop], root[start:stop])
            for rotations, root in (pose, target)
        )
        if not len(turns):
            continue
        away = positions_from_rotations(turns, roots, body)
        away -= positions_from_rotations(wanted, there, body)
        follows = np.linalg.norm(away, axis=-1) < _FOLLOWED
        last = int(np.flatnonzero(follows.all(axis=-1)).max(initial=0))
        last = max(last, int(np.searchsorted(time[start : stop - 1], earliest)))
        since = time[start:stop] - time[start + last]
        share = np.clip(1.0 + since / _BLENDING_TIME, 0.0, 1.0)
        course = np.maximum(since / (time[stop] - time[start + last]), 0.0)
        lost = ~follows[last:].all(axis=0)
        for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
            lost[j] |= lost[p]
        held = turns[np.minimum(np.arange(len(turns)), last)]
        straight = slerp(held, target[0][stop], course[:, None])
        followed = slerp(turns, wanted, share[:, None])
        turns[:] = np.where(lost[:, None], straight, followed)
        roots += share[:, None] * (there - roots)
        joints = positions_from_rotations(turns, roots, body)
        roots[:, 1] += floor_penetration(joints[..., 1], standing)
