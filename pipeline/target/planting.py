"""Feet that stand where they stand, and are lifted where they step."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.retarget.runs import runs
from kinefilter.retarget.smooth_step import smooth_step

from .contacts import ankles_and_toes
from .smooth import smooth

PLANTED = 20.0
"""Firmness of a standing foot where bones ask for a move; a measured joint has 1."""
_HEEL_ERROR = 0.10  # m: a standing ankle that is higher than this has left the floor
_HEEL_DOWN = 0.01  # m that a heel rises and still counts as down
_LIFT_TIME = 0.1  # s: to lift a foot that high, and to set it down
_SLIDE_SPEED = 0.15  # m/s: a foot that is faster is lifted
_CLEARANCE = 0.065  # m between the floor and a sole that moves. People walk with less,
# but a viewer takes what is lower for sliding.
_HOLD = 0.08  # s that a foot stays over its place while it is lifted or set down
_CATCH_UP = 0.15  # s in which it joins the measured path then
_FIRM = 1e4  # weight of a standing foot in the smoother, against a step's 1
_CUTOFF = 6.0  # Hz: what rounds the corners of steps


def plant_feet(
    time: Array,
    positions: Array,
    trust: Array,
    stands: NDArray[np.bool_],
    body: Body,
    heels: NDArray[np.bool_] | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return positions (T, J, 3) whose feet rest while they stand, and their heels.

    Ankle and toes of a standing foot stay in one place, that of their weighted median,
    the sole on the floor; the heel rises only where the ankle is higher than Kinect's
    errors lift it. A foot that steps follows the measurement, moved so that it leaves
    and arrives where it stands, and lifted where it is fast.

    The second result says whether each heel is on the floor, shape (T, 2).

    Args:
        time: Time stamps [s], strictly increasing, shape (T,).
        positions: Joint positions [m], y up, floor at 0, shape (T, J, 3).
        trust: Share of the measurement in each joint, in [0, 1], shape (T, J).
        stands: Whether each foot stands, shape (T, 2).
        body: Whose feet they are.
        heels: Where heels are down in any case, shape (T, 2); elsewhere as found.
    """
    planted, down = positions.copy(), np.zeros_like(stands)
    feet = zip(*ankles_and_toes(body.skeleton), strict=True)
    for foot, (ankle, toe) in enumerate(feet):
        stances = runs(stands[:, foot])
        if not stances:
            continue
        path = positions[:, [ankle, toe]]
        flat = flat_height(body, toe)
        rise = np.maximum(path[:, 0, 1] - flat - _HEEL_ERROR, 0.0)
        if heels is not None:
            rise[heels[:, foot]] = 0.0
        down[:, foot] = stands[:, foot] & (rise < _HEEL_DOWN)
        resting = [
            _resting(path[s], trust[s, ankle], rise[s], body, toe) for s in stances
        ]
        path = _joined(time, path, resting, stances)
        path[:, :, 1] += _lift(time, path[:, 1], body.radii[toe], stands[:, foot])
        firm = np.where(stands[:, [foot, foot]], _FIRM, 1.0)
        planted[:, [ankle, toe]] = smooth(time, path, firm, cutoff=_CUTOFF)
    return planted, down


def flat_height(body: Body, toe: int) -> float:
    """Return the height [m] of the ankle of a foot that is flat on the floor."""
    ankle = float(body.rest_positions[body.skeleton.parents[toe], 1])
    return min(ankle, float(body.radii[toe] + body.lengths[toe]))


def _resting(path: Array, weights: Array, rise: Array, body: Body, toe: int) -> Array:
    """Return ankle and toe of one stance [m], shape (T, 2, 3)."""
    place = [_median(path[:, 0, axis], weights) for axis in (0, 2)]
    ahead = np.median(path[:, 1] - path[:, 0], axis=0)[[0, 2]]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    length, sole = body.lengths[toe], body.radii[toe]
    flat = flat_height(body, toe)
    reach = np.sqrt(max(length**2 - (flat - sole) ** 2, 0.0))
    rest = np.zeros((len(path), 2, 3))
    rest[:, 1, [0, 2]] = place + reach * ahead
    rest[:, 1, 1] = sole
    # The ankle turns about the toes.
    height = np.minimum(flat + rise, sole + length)
    back = np.sqrt(np.maximum(length**2 - (height - sole) ** 2, 0.0))
    rest[:, 0, [0, 2]] = rest[:, 1][:, [0, 2]] - back[:, None] * ahead
    rest[:, 0, 1] = height
    return rest


def _joined(
    time: Array, path: Array, resting: list[Array], stances: list[slice]
) -> Array:
    """Return stances and the steps between them [m], shape (T, 2, 3).

    A step is the measured one, moved; while the foot is lifted and set down it stays
    over the place where it stands.
    """
    joined = np.empty_like(path)
    moves = [r - path[s] for r, s in zip(resting, stances, strict=True)]
    for rest, stance in zip(resting, stances, strict=True):
        joined[stance] = rest
    # Before the first stance and after the last there is only one end to fit.
    ends = [None, *range(len(stances)), None]
    for before, after in pairwise(ends):
        first = 0 if before is None else stances[before].stop
        last = len(path) if after is None else stances[after].start
        if first == last:
            continue
        gap = slice(first, last)
        leave = np.zeros((1, 2, 3)) if before is None else moves[before][-1]
        arrive = leave if after is None else moves[after][0]
        leave = arrive if before is None else leave
        step = path[gap] + leave
        if before is not None and after is not None:
            over = time[gap] - time[first - 1]
            share = _ease(over / (time[last] - time[first - 1]))
            step = step + share * (arrive - leave)
        if before is not None:
            free = _ease((time[gap] - time[first - 1] - _HOLD) / _CATCH_UP)
            step = free * step + (1.0 - free) * joined[first - 1]
        if after is not None:
            free = _ease((time[last] - time[gap] - _HOLD) / _CATCH_UP)
            step = free * step + (1.0 - free) * joined[last]
        joined[gap] = step
    return joined


def _lift(time: Array, toe: Array, sole: float, stands: NDArray[np.bool_]) -> Array:
    """Return by how much a foot is lifted in each frame [m], shape (T, 1)."""
    steps = np.diff(time)
    speed = np.linalg.norm(np.diff(toe[:, [0, 2]], axis=0), axis=1) / steps
    fast = np.concatenate([[0.0], speed]), np.concatenate([speed, [0.0]])
    needed = np.where(np.maximum(*fast) > _SLIDE_SPEED, _CLEARANCE, 0.0)
    needed[stands] = 0.0
    # Up and down at an even speed, which needs frames before and after.
    slope = _CLEARANCE / _LIFT_TIME
    edge = np.where(stands, 0.0, np.inf)
    for k in range(1, len(time)):
        edge[k] = min(edge[k], edge[k - 1] + slope * steps[k - 1])
        needed[k] = max(needed[k], needed[k - 1] - slope * steps[k - 1])
    for k in range(len(time) - 2, -1, -1):
        edge[k] = min(edge[k], edge[k + 1] + slope * steps[k])
        needed[k] = max(needed[k], needed[k + 1] - slope * steps[k])
    needed = np.minimum(needed, edge)
    lift = np.maximum(needed - (toe[:, 1] - sole), 0.0)
    lift[stands] = 0.0
    return lift[:, None]


def _ease(share: Array) -> Array:
    """Return a smooth step of shares, shape (T, 1, 1)."""
    return smooth_step(share)[:, None, None]


def _median(values: Array, weights: Array) -> float:
    """Return the weighted median, between two values where both are in the middle."""
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order] + 1e-3)
    half, rounding = 0.5 * sums[-1], 1e-9 * sums[-1]
    middle = np.searchsorted(sums, [half - rounding, half + rounding])
    return float(values[order][middle].mean())
