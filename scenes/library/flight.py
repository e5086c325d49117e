"""A ball in free flight: parabolas between bounces.

Heights are of the ball's lowest point above the floor, speeds upward. Air and spin are
left out: at 5 m/s the air takes less than a tenth of what gravity gives a basketball.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters.arrays import Array
from kinefilter.characters.humanoid import GRAVITY

RESTITUTION = 0.767
"""Speed after over speed before a bounce: a ball dropped from 1.8 m, measured at its
bottom, comes back to 1.3 m, measured at its top, the middle of what FIBA allows."""
_BOUNCES = 14  # the last one rises less than 3 mm after a fall from 2 m
_ROLLING_TIME = 1.2  # s until a rolling ball has lost most of its speed: a guess
_GRID = 0.06  # m/s: two launch speeds that both hit are further apart than this
_FASTEST_PUSH = 12.0  # m/s, more than a dribbler's hand


def flown(height: ArrayLike, speed: ArrayLike, duration: ArrayLike) -> Array:
    """Return the height [m] after a time of flight and bouncing; arguments broadcast.

    Args:
        height: Height at the start [m], not negative.
        speed: Upward speed at the start [m/s].
        duration: Time since then [s].
    """
    h, v, t = np.broadcast_arrays(
        *(np.asarray(value, dtype=float) for value in (height, speed, duration))
    )
    for _ in range(_BOUNCES):
        impact = np.sqrt(v * v + 2.0 * GRAVITY * h)
        fall = (v + impact) / GRAVITY
        down = t > fall
        h = np.where(down, 0.0, h)
        v = np.where(down, RESTITUTION * impact, v)
        t = np.where(down, t - fall, t)
    lies = t > (v + np.sqrt(v * v + 2.0 * GRAVITY * h)) / GRAVITY
    rise = h + v * t - 0.5 * GRAVITY * t * t
    return np.asarray(np.where(lies, 0.0, np.maximum(rise, 0.0)))


def rolled(height: float, speed: float, duration: ArrayLike) -> Array:
    """Return how long [s] the ball would have flown as far as it has come, level.

    The way along the floor is that times the level speed: in the air it is the time
    itself, and from the first bounce on the ball slows down as it rolls.
    """
    time = np.asarray(duration, dtype=float)
    fall = (speed + np.sqrt(speed**2 + 2.0 * GRAVITY * height)) / GRAVITY
    rolling = np.maximum(time - fall, 0.0)
    slowed = _ROLLING_TIME * (1.0 - np.exp(-rolling / _ROLLING_TIME))
    return np.asarray(np.minimum(time, fall) + slowed)


def launch_speed(
    start: ArrayLike,
    end: ArrayLike,
    duration: ArrayLike,
    wish: ArrayLike,
    *,
    bouncing: bool = False,
) -> Array:
    """Return the upward speed [m/s] with which a ball comes from one height to another.

    Of all speeds that do, with any number of bounces, the one nearest to a wish. There
    always is one: a throw without a bounce. Arguments broadcast.

    Args:
        start: Height at the start [m].
        end: Height at the end [m].
        duration: Time between them [s], positive.
        wish: Upward speed of the hand that lets go [m/s].
        bouncing: Only speeds with at least one bounce; NaN where there is none.
    """
    start, end, duration, wish = np.broadcast_arrays(
        *(np.asarray(value, dtype=float) for value in (start, end, duration, wish))
    )
    throw = (end - start) / duration + 0.5 * GRAVITY * duration
    bound = max(_FASTEST_PUSH, float(np.max(np.abs(throw), initial=0.0)) + _GRID)
    grid = np.linspace(-bound, bound, 2 * int(np.ceil(bound / _GRID)) + 1)
    over = flown(start[..., None], grid, duration[..., None]) > end[..., None]
    hit = over[..., 1:] != over[..., :-1]
    if bouncing:
        fall = grid[:-1] + np.sqrt(grid[:-1] ** 2 + 2.0 * GRAVITY * start[..., None])
        hit &= fall < GRAVITY * duration[..., None]
    away = np.where(hit, np.abs(grid[:-1] - wish[..., None]), np.inf)
    low = grid[np.argmin(away, axis=-1)]
    high = low + (grid[1] - grid[0])
    rising = ~np.take_along_axis(over, np.argmin(away, axis=-1)[..., None], -1)[..., 0]
    for _ in range(40):
        middle = 0.5 * (low + high)
        too_low = (flown(start, middle, duration) > end) != rising
        low, high = np.where(too_low, middle, low), np.where(too_low, high, middle)
    otherwise = np.nan if bouncing else throw
    return np.asarray(np.where(hit.any(axis=-1), 0.5 * (low + high), otherwise))
