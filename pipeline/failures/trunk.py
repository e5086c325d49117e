"""Turns hips and shoulders evenly where a sensor does not see which way they face.

A sensor shows the trunks of people at its side turned toward itself, and turns them
about where it swaps sides. Of two hips or shoulders, one behind the other, it guesses
the hidden one: the line between them gets short, or twists the trunk as nobody can.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import wrapped

# Chosen on walks of p00 to p08 of two-kinects.
_JUMP = np.radians(20.0)  # rad from a frame to the next: no turn, the heading jumps
_FASTEST = np.radians(900.0)  # rad/s: where sides do not change, turns are slower
_EVENLY = 0.35  # s before and after a jump in which the trunk turns instead
_SHORT = 0.65  # of its median length: a shorter line points anywhere
_WRUNG = np.radians(90.0)  # rad between hips and shoulders: more than any trunk twists
_FOLDED = 0.75  # of its length at rest: correction makes no line shorter
_TWISTED = np.radians(45.0)  # rad: at most 44 in mocap of the six people of UI-PRMD
_UPRIGHT = 0.7  # cosine of the angle to straight up within which lines are judged


def steadied(take: Take, changes: Sequence[int]) -> Take:
    """Return a take in which hips and shoulders turn evenly where they show nothing.

    ``changes`` are the first frames after trunk and arms have changed sides. Only hips
    and shoulders move, each pair about its middle and without changing height.
    """
    lengths = np.linalg.norm(_lines(take.positions, take.skeleton), axis=2)
    if np.isnan(lengths).all(axis=0).any():
        return take
    usual, limits = np.nanmedian(lengths, axis=0), (_SHORT, _WRUNG)
    joints = take.time, take.positions, take.skeleton
    return replace(take, positions=_steadied(*joints, usual, limits, changes))


def possible_trunk(time: Array, positions: Array, body: Body) -> Array:
    """Return corrected joints [m] (T, J, 3) whose trunk is not folded nor wrung.

    Correction of somebody who turns may move one shoulder or hip into the other.
    """
    lines = _lines(body.rest_positions[None], body.skeleton)[0]
    usual, limits = np.linalg.norm(lines, axis=1), (_FOLDED, _TWISTED)
    return _steadied(time, positions, body.skeleton, usual, limits, ())


def _pairs(skeleton: Skeleton) -> NDArray[np.intp]:
    return np.array([skeleton.hips, skeleton.sides("Shoulder")])


def _lines(positions: Array, skeleton: Skeleton) -> Array:
    """Return the lines from right to left, of hips and shoulders, (T, 2, 3)."""
    ends = positions[:, _pairs(skeleton)]
    return np.asarray(ends[:, :, 0] - ends[:, :, 1])


def _steadied(
    time: Array,
    positions: Array,
    skeleton: Skeleton,
    usual: Array,
    limits: tuple[float, float],
    changes: Sequence[int],
) -> Array:
    """Return joints (T, J, 3) as for ``steadied``.

    Lines show nothing where they are shorter than a share of the ``usual`` length [m],
    (2,), or turned against each other by an angle [rad], the ``limits``.
    """
    lines, usual = _lines(positions, skeleton), np.maximum(usual, 1e-3)
    lengths, (short, twisted) = np.linalg.norm(lines, axis=2), limits
    known = np.isfinite(lengths)
    trunk = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    upright = trunk[:, 1] > _UPRIGHT * np.linalg.norm(trunk, axis=1)
    level = lines[..., 0] - 1j * lines[..., 2]  # its angle is the yaw
    good = known & ((lengths >= short * usual) | ~upright[:, None])
    yaw = np.angle(level)
    wrung = upright & (np.abs(wrapped(yaw[:, 0] - yaw[:, 1])) > twisted)
    shown = _moved(_heading(level / usual, good))
    likely = _moved(_heading(level / usual, good & ~wrung[:, None]))
    fast = np.maximum(_FASTEST * np.diff(time, prepend=-np.inf), _JUMP)
    jumps = [k for k in changes if shown[k] > _JUMP]
    for k in [*jumps, *np.flatnonzero(likely > fast).tolist()]:
        if good[k - 1 : k + 1].any():
            good &= (np.abs(time - time[k - 1 : k + 1].mean()) > _EVENLY)[:, None]
    heading = _heading(level / usual, good & ~wrung[:, None])
    away = wrapped(yaw - heading[:, None])
    good &= ~wrung[:, None] | (np.abs(away) < 0.5 * twisted)
    bad, positions = known & ~good, positions.copy()
    for k, (left, right) in enumerate(_pairs(skeleton)):
        ok, some, line = good[:, k], bad[:, k], level[:, k]
        if ok.any() and some.any():
            way = heading + np.interp(time, time[ok], away[ok, k])
            reach = np.abs(line)
            reach = np.maximum(reach, np.interp(time, time[ok], reach[ok]))
            turned = reach * np.exp(1j * way) - line
            half = 0.5 * np.stack([turned.real, 0.0 * reach, -turned.imag], axis=1)
            positions[some, left] += half[some]
            positions[some, right] -= half[some]
    return positions


def _heading(lines: Array, good: Flags) -> Array:
    """Return the yaw of the trunk [rad], (T,), between good frames the shorter way."""
    total = np.where(good, lines, 0.0).sum(axis=1)
    seen = np.flatnonzero(np.abs(total) > 0.0)
    if not len(seen):
        return np.zeros(len(lines))
    yaw = np.unwrap(np.angle(total[seen]))
    return np.asarray(np.interp(np.arange(len(lines)), seen, yaw))


def _moved(yaw: Array) -> Array:
    """Return how far headings are from those of the frame before [rad], (T,)."""
    return np.abs(wrapped(np.diff(yaw, prepend=yaw[0])))
