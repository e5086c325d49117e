"""A basketball along the script: held, dribbled, thrown, as the hands have it.

The ball is between the hands while both are near, under the hand that dribbles it, and
otherwise flies as a ball does.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters.arrays import Array

from .dribble import Contact, Ending, contacts, holds, under
from .flight import flown, launch_speed, rolled
from .hands import Hands, fading

_FLICK = 2.0  # what wrists and fingers make of the speed of a throw, a guess
_BLEND = 0.08  # s: from under one hand to between both, standard deviation, a guess


def ball_path(hands: Hands, radius: float, rest: Array) -> Array:
    """Return where the center of the ball is [m], shape (T, 3).

    A ball that no hand touches stays where it is. One that is let go and not caught
    bounces until it lies.

    Args:
        hands: The hands.
        radius: Radius of the ball [m].
        rest: Center of the untouched ball [m], shape (3,).
    """
    path = np.tile(np.asarray(rest, dtype=float), (len(hands.time), 1))
    touches = contacts(hands, radius)
    if not touches:
        return path
    for touch in touches:
        path[touch.start : touch.end + 1] = _in_hands(hands, touch, radius)
    _lie_until(path, hands, touches[0].start, radius)
    for before, after in pairwise(touches):
        _fly(path, hands, before, after.start, radius)
    _let_go(path, hands, touches[-1], radius)
    return path


def _in_hands(hands: Hands, touch: Contact, radius: float) -> Array:
    """Center of the ball [m] in every frame of a contact."""
    both = np.zeros(len(hands.time))
    for first, last, _ in holds(hands, radius):
        both[first : last + 1] = 1.0
    span = slice(touch.start, touch.end + 1)
    caught = np.cumsum(both[span]) > 0.0
    share = gaussian_filter1d(both[span], _BLEND * hands.rate, mode="nearest")
    one = np.where(
        caught[:, None],
        under(hands, touch.thrower, radius)[span],
        under(hands, touch.catcher, radius)[span],
    )
    return np.asarray(one + share[:, None] * (_between(hands, radius)[span] - one))


def _between(hands: Hands, radius: float) -> Array:
    """Center of a ball that both palms touch [m], before them if they are too near."""
    away = (radius + hands.radius) ** 2 - 0.25 * hands.gap**2
    center = hands.middle + np.sqrt(np.maximum(away, 0.0))[:, None] * hands.reach
    center[:, 2] = np.maximum(center[:, 2], radius)
    return np.asarray(center)


def _lie_until(path: Array, hands: Hands, taken: int, radius: float) -> None:
    """Let the ball lie where it will be taken, until then."""
    if taken == 0:
        return
    place = np.array([*path[taken, :2], radius])
    path[:taken] = place
    fade = fading(hands.time[taken:] - hands.time[taken])
    path[taken:] += fade[:, None] * (place - path[taken])
    path[:, 2] = np.maximum(path[:, 2], radius)


def _letting_go(hands: Hands, touch: Contact) -> Array:
    """Velocity [m/s] of what lets go of the ball at the end of a contact."""
    speed = hands.speed[touch.end]
    if touch.ending is Ending.STROKE:
        return np.asarray(speed[touch.thrower])
    gain = _FLICK if touch.ending is Ending.THROW else 1.0
    return np.asarray(gain * speed.mean(axis=0))


def _fly(path: Array, hands: Hands, touch: Contact, catch: int, radius: float) -> None:
    """Fill in the flight from the end of a contact to the frame of the next catch."""
    time = hands.time[touch.end : catch + 1] - hands.time[touch.end]
    start, end = path[touch.end].copy(), path[catch].copy()
    low, high, wish = start[2] - radius, end[2] - radius, _letting_go(hands, touch)[2]
    stroke = touch.ending is Ending.STROKE
    speed = launch_speed(low, high, time[-1], wish, bouncing=stroke)
    if np.isnan(speed):
        speed = launch_speed(low, high, time[-1], wish)
    path[touch.end : catch + 1] = start + (time / time[-1])[:, None] * (end - start)
    path[touch.end : catch + 1, 2] = radius + flown(low, speed, time)


def _let_go(path: Array, hands: Hands, last: Contact, radius: float) -> None:
    """Fill in the flight of a ball that nobody catches."""
    start, speed = path[last.end].copy(), _letting_go(hands, last)
    time = hands.time[last.end :] - hands.time[last.end]
    low, up = float(start[2] - radius), float(speed[2])
    path[last.end :] = start + rolled(low, up, time)[:, None] * speed
    path[last.end :, 2] = radius + flown(low, up, time)
