"""Turns hips and shoulders evenly where a sensor does not see which way they face.

A sensor shows the trunks of people at its side turned toward itself, and turns them
about where it swaps sides. Of two hips or shoulders, one behind the other, it guesses
the hidden one: the line between them gets short, or twists the trunk as nobody can.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import wrapped

# Chosen on walks of p00 to p08 of two-kinects.
_JUMP = np.radians(20.0)  # rad from a frame to the next: no turn, the heading jumps
_FASTEST = np.radians(900.0)  # rad/s: where sides do not change, turns are slower
_EVENLY = 0.35  # s before and after a jump in which the trunk turns instead
_SHORT = 0.65  # of its median length: a shorter line points anywhere
_WRUNG = np.radians(90.0)  # rad between hips and shoulders: more than any trunk twists
_UPRIGHT = 0.7  # cosine of the angle to straight up within which lines are judged


def steadied(take: Take, changes: Sequence[int]) -> Take:
    """Return a take in which hips and shoulders turn evenly where they show nothing.

    ``changes`` are the first frames after trunk and arms have changed sides. Only hips
    and shoulders move, each pair about its middle and without changing height.
    """
    skeleton, time = take.skeleton, take.time
    pairs = np.array([skeleton.hips, skeleton.sides("Shoulder")])
    ends = take.positions[:, pairs]
    lines = ends[:, :, 0] - ends[:, :, 1]
    lengths = np.linalg.norm(lines, axis=2)
    known = np.isfinite(lengths)
    if not known.any(axis=0).all():
        return take
    usual = np.maximum(np.nanmedian(lengths, axis=0), 1e-3)
    trunk = take.positions[:, skeleton.girdle] - take.positions[:, skeleton.root]
    upright = trunk[:, 1] > _UPRIGHT * np.linalg.norm(trunk, axis=1)
    level = lines[..., 0] - 1j * lines[..., 2]  # its angle is the yaw
    good = known & ((lengths >= _SHORT * usual) | ~upright[:, None])
    yaw = np.angle(level)
    wrung = upright & (np.abs(wrapped(yaw[:, 0] - yaw[:, 1])) > _WRUNG)
    shown = _moved(_heading(level / usual, good))
    likely = _moved(_heading(level / usual, good & ~wrung[:, None]))
    fast = np.maximum(_FASTEST * np.diff(time, prepend=-np.inf), _JUMP)
    jumps = [k for k in changes if shown[k] > _JUMP]
    for k in [*jumps, *np.flatnonzero(likely > fast).tolist()]:
        if good[k - 1 : k + 1].any():
            good &= (np.abs(time - time[k - 1 : k + 1].mean()) > _EVENLY)[:, None]
    heading = _heading(level / usual, good & ~wrung[:, None])
    away = wrapped(yaw - heading[:, None])
    good &= ~wrung[:, None] | (np.abs(away) < 0.5 * _WRUNG)
    bad, positions = known & ~good, take.positions.copy()
    for k, (left, right) in enumerate(pairs):
        ok, some, line = good[:, k], bad[:, k], level[:, k]
        if ok.any() and some.any():
            way = heading + np.interp(time, time[ok], away[ok, k])
            reach = np.abs(line)
            reach = np.maximum(reach, np.interp(time, time[ok], reach[ok]))
            turned = reach * np.exp(1j * way) - line
            half = 0.5 * np.stack([turned.real, 0.0 * reach, -turned.imag], axis=1)
            positions[some, left] += half[some]
            positions[some, right] -= half[some]
    return replace(take, positions=positions)


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
