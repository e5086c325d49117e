"""Feet that stay in place while planted and are lifted to step.

Arguments are as in ``feet``.
"""

from itertools import pairwise

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.rotations import unit
from kinefilter.retarget.limbs import smooth_step

from .feet import CLEARANCE, LIFT_TIME, SLIDE_SPEED, ankles_and_toes, flat_height
from .foot_pitch import flat_angle
from .possible_postures import (
    hips_yaw,
    standing_direction,
    turned_ahead,
    uprightness,
)
from .smooth import smooth

PLANTED = 960.0  # bone weight of a planted foot; a measured joint has 1
HELD = (12.0, 40.0)
"""Bone weights of ankle and toes of a planted foot in live motion. Feet are let go of
late there: firm ones drag the hips along, which then leap. Chosen on p00, p04 and p06
of two-kinects."""
STEPPING = 8.0
"""Least bone weight of other feet. With 3, legs that get longer push heels back down,
which drag in 3 % of the frames of simulated walks with hips that are seen too low."""
_LOW, _HIGH = 0.2, 0.35
"""Heights [m] of an ankle at which all, and none, of that weight counts. Feet that kick
high, on legs that are seen 15 cm too long, draw the hips along half as far."""
_LEVEL = 1e-9  # rad: with less, both heel and toes are on the floor
_HOLD = 0.08  # s that a foot stays over its place while it is lifted or set down
_CATCH_UP = 0.15  # s in which it then joins the measured path
_BEHIND = 0.05
"""Distance [m] from the measured path up to which it does. Without it, feet land 20 cm
early. Chosen on walks of people 02, 05, 07, 16 and 29 of CMU and on every fourth
recorded take."""
_FIRM = 1e4  # weight of a planted foot in the smoother; a stepping one has 1
_STEP_CUTOFF = 6.0  # Hz: rounds the corners of steps


def stepping_weights(heights: Array) -> Array:
    """Return the least bone weights of moving feet by their ankles' heights [m]."""
    low = ((_HIGH - heights) / (_HIGH - _LOW)).clip(0.0, 1.0)
    return 1.0 + low * (STEPPING - 1.0)


def plant_feet(
    time: Array,
    positions: Array,
    confidence: Array,
    stands: Flags,
    pitch: Array,
    body: Body,
) -> tuple[Array, Flags]:
    """Return positions (T, J, 3) with planted feet at rest, and what is planted.

    Of a planted foot that is flat, ankle and toes stay at their weighted median with
    the sole on the floor, which is at y = 0; pitch [rad], (T, 2), lifts the heel or the
    toes. A stepping foot follows the measurement, with that pitch, moved so that it
    leaves and arrives where it is planted, and lifted where it is fast. Contacts,
    shape (T, 4), are those of CONTACTS.
    """
    planted = positions.copy()
    down = [pitch > -_LEVEL, pitch < _LEVEL]  # heels, and toes
    contacts = (stands[..., None] & np.stack(down, axis=2)).reshape(-1, 4)
    yaw = hips_yaw(positions, body.skeleton)
    feet = zip(*ankles_and_toes(body.skeleton), strict=True)
    for foot, (ankle, toe) in enumerate(feet):
        still = stands[:, foot]
        stances = runs(still)
        if not stances:
            continue
        below, flat = flat_angle(body) - pitch[:, foot], flat_height(body, toe)
        path = pointed(positions[:, [ankle, toe]], below, body.lengths[toe])
        weights, joined = confidence[:, ankle], path.copy()
        upright = uprightness(positions[:, body.skeleton.parents[ankle]] - path[:, 0])
        for s in stances:
            hips = yaw[s][upright[s] == 1.0]
            joined[s] = _resting(path[s], weights[s], below[s], hips, body, toe)
        path = _joined(time, path, joined, stances)
        path[~still] = turned_ahead(path, yaw, upright)[~still]
        soles = ((path[:, 0], flat), (path[:, 1], body.radii[toe]))
        lifts = [_lift(time, part, height, still) for part, height in soles]
        path[:, :, 1] += np.maximum(*lifts)[:, None]
        firm = np.where(stands[:, [foot, foot]], _FIRM, 1.0)
        planted[:, [ankle, toe]] = smooth(time, path, firm, cutoff=_STEP_CUTOFF)
    return planted, contacts


def pointed(foot: Array, below: Array, length: float) -> Array:
    """Return ankles and toes [m], (N, 2, 3), with toes at angles below level [rad]."""
    ahead = unit((foot[:, 1] - foot[:, 0])[:, [0, 2]]) * np.cos(below)[:, None]
    toes = np.stack([ahead[:, 0], -np.sin(below), ahead[:, 1]], axis=1)
    return np.stack([foot[:, 0], foot[:, 0] + length * toes], axis=1)


def _resting(
    path: Array, weights: Array, below: Array, yaw: Array, body: Body, toe: int
) -> Array:
    """Return ankle and toe of one stance [m], shape (T, 2, 3).

    Flat, the ankle is over its weighted median. It rises while the toes are on the
    floor, which is at y = 0, or the toes rise: they are ``below`` it [rad], (T,).
    ``yaw`` is where the hips head [rad] in the frames in which the shank is upright.
    """
    ahead = np.median(path[:, 1] - path[:, 0], axis=0)[[0, 2]]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    if len(yaw):
        ahead = standing_direction(ahead, yaw)
    turned = standing_feet(np.zeros(2), ahead, below, body, toe)
    place = path[:, 0, [0, 2]] - turned[:, 0, [0, 2]]
    turned[..., [0, 2]] += [_median(place[:, axis], weights) for axis in range(2)]
    return turned


def standing_feet(
    place: Array, ahead: Array, below: Array, body: Body, toe: int
) -> Array:
    """Return ankle and toes [m], (..., 2, 3), of a foot with one of them on the floor.

    Flat, the ankle is over a place; the toes are ``ahead``, both x and z, (..., 2), and
    ``below`` level by an angle [rad], (...). They stay in place while the heel is up.
    """
    length, flat = body.lengths[toe], flat_angle(body)
    fall, reach = length * np.sin(below), length * np.cos(below)
    forward = np.where(below > flat, length * np.cos(flat) - reach, 0.0)
    ankle = place + forward[..., None] * ahead
    tip = ankle + reach[..., None] * ahead
    height = np.maximum(body.radii[toe] + fall, flat_height(body, toe))
    ends = [np.stack([ankle[..., 0], height, ankle[..., 1]], axis=-1)]
    ends.append(np.stack([tip[..., 0], height - fall, tip[..., 1]], axis=-1))
    return np.stack(ends, axis=-2)


def _median(values: Array, weights: Array) -> float:
    """Return the weighted median, the mean of two values if both are in the middle."""
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order] + 1e-3)
    half, rounding = 0.5 * sums[-1], 1e-9 * sums[-1]
    middle = np.searchsorted(sums, [half - rounding, half + rounding])
    return float(values[order][middle].mean())


def _joined(time: Array, path: Array, joined: Array, stances: list[slice]) -> Array:
    """Fill the steps between stances into ``joined`` [m], shape (T, 2, 3).

    A step is the measured one, moved, but stays near its place when up and down.
    """

    def held(step: Array, place: Array, free: Array) -> Array:
        away = place - step
        far = np.linalg.norm(away[..., [0, 2]], axis=2, keepdims=True)
        share = np.minimum(_BEHIND * (1.0 - free) / (far + 1e-9), 1.0)
        return np.asarray(step + share * away)

    moves, count = joined - path, len(path)
    # Before the first stance and after the last there is only one end to fit.
    for before, after in pairwise([slice(0, 0), *stances, slice(count, count)]):
        first, last = before.stop, after.start
        over = time[first:last, None, None]
        leave = moves[first - 1 if first else last]
        step = path[first:last] + leave
        if first and last < count:
            duration = time[last] - time[first - 1]
            share = smooth_step((over - time[first - 1]) / duration)
            step = step + share * (moves[last] - leave)
        if first:
            free = smooth_step((over - time[first - 1] - _HOLD) / _CATCH_UP)
            step = held(step, joined[first - 1], free)
        if last < count:
            free = smooth_step((time[last] - over - _HOLD) / _CATCH_UP)
            step = held(step, joined[last], free)
        joined[first:last] = step
    return joined


def _lift(time: Array, part: Array, sole: float, stands: Flags) -> Array:
    """Return by how much to lift ankle or toes (T, 3), ``sole`` high at rest [m]."""
    steps = np.diff(time)
    speed = np.linalg.norm(np.diff(part[:, [0, 2]], axis=0), axis=1) / steps
    fast = np.concatenate([[0.0], speed]), np.concatenate([speed, [0.0]])
    needed = np.where((np.maximum(*fast) > SLIDE_SPEED) & ~stands, CLEARANCE, 0.0)
    # Up and down at a constant speed, which takes frames before and after.
    slopes = CLEARANCE / LIFT_TIME * steps
    edge = np.where(stands, 0.0, np.inf)
    for way in (1, -1):
        low, high, slope = edge[::way], needed[::way], slopes[::way]
        for k in range(1, len(time)):
            low[k] = min(low[k], low[k - 1] + slope[k - 1])
            high[k] = max(high[k], high[k - 1] - slope[k - 1])
    lift = np.maximum(np.minimum(needed, edge) - (part[:, 1] - sole), 0.0)
    return np.where(stands, 0.0, lift)
