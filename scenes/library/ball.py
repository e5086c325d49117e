"""A ball along the script: held, dribbled and thrown as the hands have it, else flying.

Heights of a flight are of the ball's lowest point above the floor, speeds upward. Air
and spin are left out: at 5 m/s the air takes less than a tenth of what gravity gives a
basketball. The hands were not moved for the ball, so it leaves the hand of a stroke and
comes back in those frames in which a flying ball fits the hands best.
"""

from __future__ import annotations

from enum import Enum
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, runs

from .hands import Hands, fading
from .poses import LEFT, RIGHT

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


# Guesses that suit the scripted motions and a ball of size 7.
_ROOM = 0.12  # m: most room left between the ball and both hands
_SHORTEST_HOLD = 0.1  # s
_STROKE = 0.1  # m: a hand that dribbles comes down at least so far
_HIGHEST = 0.3  # m above the bottom of a stroke: where a hand meets the ball at most
_STROKE_HEIGHTS = (0.3, 1.2)  # m, of the hand at the bottom of a stroke
_STROKE_TIME = 0.25  # s: two strokes that are nearer in time are one
_LONGEST_FLIGHT = 0.9  # s from the bottom of a stroke until a hand has the ball back
_THROW = 1.0  # m/s: hands over the head that rise faster throw the ball
_LOW = 0.35  # m: a ball that is first taken below this had been lying on the floor
_CATCH = 0.5  # weight of the misfit at the catch against that at the release
_BOTH = -1


class Ending(Enum):
    """How the ball leaves the hands."""

    STROKE = "one hand pushes it to the floor"
    THROW = "both hands throw it"
    PART = "the hands part"


class _Event(NamedTuple):
    """A hold from first to last frame, or the bottom of a stroke."""

    first: int
    last: int
    hand: int
    thrown: bool = False


class Contact(NamedTuple):
    """Frames, both included, in which the ball is in the hands, not in flight."""

    start: int
    end: int
    catcher: int
    """LEFT or RIGHT: the hand that has it before both have."""
    thrower: int
    """The hand that has it after both have."""
    ending: Ending
    """How the ball leaves."""


def holds(hands: Hands, radius: float) -> list[tuple[int, int, bool]]:
    """Return first and last frame of holds with both hands, and if a throw ends them.

    Without a throw a hold ends where the hands part.
    """
    near = hands.gap < 2.0 * (radius + hands.radius) + _ROOM
    rise = hands.speed[..., 2].mean(axis=1)
    fast = (rise > _THROW) & (hands.middle[:, 2] > hands.head)
    found = []
    for run in runs(near, hands.frames(_SHORTEST_HOLD)):
        last, throws = run.stop - 1, runs(fast[run])
        if throws:  # the ball leaves at the highest speed, the hands stay together
            start = run.start + throws[0].start
            last = start + int(np.argmax(rise[run][throws[0]]))
        found.append((run.start, last, bool(throws)))
    return found


def under(hands: Hands, hand: int, radius: float) -> Array:
    """Center of a ball under one palm [m], not in the floor, shape (T, 3)."""
    center = hands.positions[:, hand].copy()
    center[:, 2] = np.maximum(center[:, 2] - hands.radius - radius, radius)
    return center


def contacts(hands: Hands, radius: float) -> list[Contact]:
    """Return when hands have the ball, in order of time.

    Args:
        hands: The hands.
        radius: Radius of the ball [m].
    """
    events = _events(hands, radius)
    found: list[Contact] = []
    start = None if _lies_at_first(events, hands, radius) else 0
    hand = next((event.hand for event in events if event.hand != _BOTH), RIGHT)
    for event, following in zip_longest(events, events[1:]):
        if start is None:
            start = _top(hands, event, found[-1].end + 1 if found else 0)
        if event.hand != _BOTH:
            release, catch = _stroke(hands, start, event, following, radius)
            found.append(Contact(start, release, hand, event.hand, Ending.STROKE))
            start, hand = catch, _catcher(event, following)
        elif event.thrown or following is None or following.hand == _BOTH:
            ending = Ending.THROW if event.thrown else Ending.PART
            found.append(Contact(start, event.last, hand, hand, ending))
            start = None
    return found


def _top(hands: Hands, event: _Event, earliest: int) -> int:
    """Return the first frame of a hold, or the one of a stroke where the hand is up."""
    if event.hand == _BOTH:
        return event.first
    height, frame = hands.positions[:, event.hand, 2], event.first
    highest = height[frame] + _HIGHEST
    while frame > earliest and height[frame] < height[frame - 1] < highest:
        frame -= 1
    return frame


def _lies_at_first(events: list[_Event], hands: Hands, radius: float) -> bool:
    """Tell whether the ball lies on the floor until both hands take it."""
    if not events or events[0].hand != _BOTH:
        return False
    return bool(hands.middle[events[0].first, 2] - radius < _LOW)


def _events(hands: Hands, radius: float) -> list[_Event]:
    """Return holds and strokes in order of time."""
    held = [_Event(a, b, _BOTH, thrown) for a, b, thrown in holds(hands, radius)]
    bottoms = []
    for hand in (LEFT, RIGHT):
        height = hands.positions[:, hand, 2]
        frames, shape = find_peaks(-height, prominence=_STROKE)
        for k, depth in zip(frames.tolist(), shape["prominences"], strict=True):
            if _STROKE_HEIGHTS[0] < height[k] < _STROKE_HEIGHTS[1]:
                bottoms.append((float(depth), _Event(k, k, hand)))
    strokes: list[_Event] = []
    for _, stroke in sorted(bottoms, reverse=True):  # the deeper one of two counts
        near = (abs(stroke.first - other.first) for other in strokes)
        free = not any(hold.first <= stroke.first <= hold.last for hold in held)
        if free and min(near, default=np.inf) > hands.frames(_STROKE_TIME):
            strokes.append(stroke)
    return sorted(held + strokes)


def _catcher(stroke: _Event, following: _Event | None) -> int:
    """Return which hand gets the ball after a stroke."""
    if following is None or following.hand == _BOTH:
        return stroke.hand
    return following.hand


def _stroke(
    hands: Hands, start: int, stroke: _Event, following: _Event | None, radius: float
) -> tuple[int, int | None]:
    """Return in which frame a stroke lets go, and in which a hand has the ball back."""
    release = np.arange(_top(hands, stroke, start), stroke.first + 1)
    latest = stroke.first + hands.frames(_LONGEST_FLIGHT)
    latest = stroke.first if following is None else min(following.first - 1, latest)
    if latest == stroke.first:
        return int(release[np.argmin(hands.speed[release, stroke.hand, 2])]), None
    catcher = _catcher(stroke, following)
    rise = hands.positions[stroke.first + 1 : latest + 1, catcher, 2]
    catch = stroke.first + 1 + np.arange(1 + int(np.argmax(rise)))
    return _best_flight(hands, release, catch, (stroke.hand, catcher), radius)


def _best_flight(
    hands: Hands,
    release: NDArray[np.int64],
    catch: NDArray[np.int64],
    pair: tuple[int, int],
    radius: float,
) -> tuple[int, int | None]:
    """Return the frames whose flight starts and ends nearest to the hands' speeds.

    The ball bounces on its way; if it cannot, it is not caught.
    """
    before, after = np.meshgrid(release, catch, indexing="ij")
    start = under(hands, pair[0], radius)[before, 2] - radius
    end = under(hands, pair[1], radius)[after, 2] - radius
    duration = hands.time[after] - hands.time[before]
    thrown = hands.speed[before, pair[0], 2]
    speed = launch_speed(start, end, duration, thrown, bouncing=True)
    moment = 1e-4  # s
    arrival = (end - flown(start, speed, duration - moment)) / moment
    misfit = (speed - thrown) ** 2
    misfit += _CATCH * (arrival - hands.speed[after, pair[1], 2]) ** 2
    misfit = np.where(np.isnan(misfit), np.inf, misfit)
    i, j = np.unravel_index(np.argmin(misfit), misfit.shape)
    return int(release[i]), int(catch[j]) if np.isfinite(misfit[i, j]) else None


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
