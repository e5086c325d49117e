"""Path of a ball that a performer holds, dribbles and throws.

Flight heights are those of the ball's lowest point above the floor; speeds are upward.
Air resistance and spin are neglected. The hands were not moved for the ball, so it
leaves the hand in a stroke and returns to it in those frames in which a ballistic
flight fits the motion of the hands best.
"""

from enum import Enum
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, Indices, runs

from .performer_hands import Hands, fading
from .poses import LEFT, RIGHT

RESTITUTION = 0.767
"""Ratio of the speeds after and before a bounce: a ball dropped from 1.8 m (measured at
its bottom) rises to 1.3 m (measured at its top), the middle of FIBA's range."""
_BOUNCES = 14  # the last one rises less than 3 mm after a fall from 2 m
_ROLLING_TIME = 1.2  # s until a rolling ball has lost most of its speed: a guess
_GRID = 0.06  # m/s: two launch speeds that both hit differ by more than this
_FASTEST_PUSH = 12.0  # m/s, faster than a dribbler's hand


def flown(height: ArrayLike, speed: ArrayLike, duration: ArrayLike) -> Array:
    """Return the height [m] of a ball with an upward speed [m/s] after a time [s]."""
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
    """Return the way per launch speed [s]; after the first bounce it rolls."""
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
    """Return the upward speed [m/s] that takes a ball from one height to another.

    Of all such speeds, with any number of bounces, this is the one closest to the
    ``wish``, that of the hand at the release [m/s]. Heights [m], the time between them
    [s], positive, and the wish broadcast. A throw is always possible; ``bouncing``
    requires at least one bounce, and the speed is NaN where that is impossible.
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
        fall = grid[1:] + np.sqrt(grid[1:] ** 2 + 2.0 * GRAVITY * start[..., None])
        hit &= fall < GRAVITY * duration[..., None]
    away = np.where(hit, np.abs(grid[:-1] - wish[..., None]), np.inf)
    nearest = np.argmin(away, axis=-1)
    low = grid[nearest]
    high = low + (grid[1] - grid[0])
    rising = ~np.take_along_axis(over, nearest[..., None], -1)[..., 0]
    for _ in range(40):
        middle = 0.5 * (low + high)
        too_low = (flown(start, middle, duration) > end) != rising
        low, high = np.where(too_low, middle, low), np.where(too_low, high, middle)
    fallback = np.nan if bouncing else throw
    return np.asarray(np.where(hit.any(axis=-1), 0.5 * (low + high), fallback))


# Guesses that suit the scripted motions and a ball of size 7.
_ROOM = 0.12  # m: largest total gap between the ball and both hands in a hold
_SHORTEST_HOLD = 0.1  # s
_STROKE = 0.1  # m: smallest depth of a dribbling stroke
_HIGHEST = 0.3  # m above the bottom of a stroke: highest place to meet the ball
_STROKE_HEIGHTS = (0.3, 1.2)  # m, of the hand at the bottom of a stroke
_STROKE_TIME = 0.25  # s: strokes closer together in time count as one
_LONGEST_FLIGHT = 0.9  # s from the bottom of a stroke to the catch
_THROW = 1.0  # m/s: hands above the head that rise faster than this throw the ball
_LOW = 0.35  # m: a ball first grasped below this was lying on the floor
_CATCH = 0.5  # weight of the misfit at the catch relative to the release
_BOTH = -1


class Ending(Enum):
    """The way in which the ball leaves the hands."""

    STROKE = "one hand pushes it to the floor"
    THROW = "both hands throw it"
    PART = "the hands part"


class _Event(NamedTuple):
    """A hold from its first to its last frame, or the bottom of a stroke."""

    first: int
    last: int
    hand: int
    thrown: bool = False


class Contact(NamedTuple):
    """Interval of frames, ends included, in which the ball is in the hands."""

    start: int
    end: int
    catcher: int  # hand (LEFT or RIGHT) that has the ball before both hands do
    thrower: int  # hand that has the ball after both hands did
    ending: Ending


def _holds(hands: Hands, radius: float) -> list[_Event]:
    """Return the two-handed holds, each ending at a throw or where the hands part."""
    near = hands.gap < 2.0 * (radius + hands.radius) + _ROOM
    rise = hands.speed[..., 2].mean(axis=1)
    fast = (rise > _THROW) & (hands.middle[:, 2] > hands.head)
    events = []
    for run in runs(near, hands.frames(_SHORTEST_HOLD)):
        last, throws = run.stop - 1, runs(fast[run])
        if throws:  # the ball leaves at the highest speed; the hands stay together
            start = run.start + throws[0].start
            last = start + int(np.argmax(rise[run][throws[0]]))
        events.append(_Event(run.start, last, _BOTH, bool(throws)))
    return events


def _under(hands: Hands, hand: int, radius: float) -> Array:
    """Return the center of a ball under one palm, above the floor [m], (T, 3)."""
    center = hands.positions[:, hand].copy()
    center[:, 2] = np.maximum(center[:, 2] - hands.radius - radius, radius)
    return center


def contacts(hands: Hands, radius: float) -> list[Contact]:
    """Return in order of time when hands have a ball of the given radius [m]."""
    events = _events(hands, radius)
    touches: list[Contact] = []
    start: int | None = 0
    hold_first = bool(events) and events[0].hand == _BOTH
    if hold_first and hands.middle[events[0].first, 2] - radius < _LOW:
        start = None  # the ball lies on the floor until the first hold
    hand = next((event.hand for event in events if event.hand != _BOTH), RIGHT)
    for event, following in zip_longest(events, events[1:]):
        if start is None:
            start = _top(hands, event, touches[-1].end + 1 if touches else 0)
        if event.hand != _BOTH:
            release, catch = _stroke(hands, start, event, following, radius)
            touches.append(Contact(start, release, hand, event.hand, Ending.STROKE))
            start, hand = catch, _catcher(event, following)
        elif event.thrown or following is None or following.hand == _BOTH:
            ending = Ending.THROW if event.thrown else Ending.PART
            touches.append(Contact(start, event.last, hand, hand, ending))
            start = None
    return touches


def _top(hands: Hands, event: _Event, earliest: int) -> int:
    """Return the first frame of a hold, or the frame in which a stroke begins."""
    if event.hand == _BOTH:
        return event.first
    height, frame = hands.positions[:, event.hand, 2], event.first
    highest = height[frame] + _HIGHEST
    while frame > earliest and height[frame] < height[frame - 1] < highest:
        frame -= 1
    return frame


def _events(hands: Hands, radius: float) -> list[_Event]:
    held = _holds(hands, radius)
    bottoms = []
    for hand in (LEFT, RIGHT):
        height = hands.positions[:, hand, 2]
        frames, shape = find_peaks(-height, prominence=_STROKE)
        for k, depth in zip(frames.tolist(), shape["prominences"], strict=True):
            if _STROKE_HEIGHTS[0] < height[k] < _STROKE_HEIGHTS[1]:
                bottoms.append((float(depth), _Event(k, k, hand)))
    strokes: list[_Event] = []
    for _, stroke in sorted(bottoms, reverse=True):  # the deeper of two strokes counts
        near = (abs(stroke.first - other.first) for other in strokes)
        free = not any(hold.first <= stroke.first <= hold.last for hold in held)
        if free and min(near, default=np.inf) > hands.frames(_STROKE_TIME):
            strokes.append(stroke)
    return sorted(held + strokes)


def _catcher(stroke: _Event, following: _Event | None) -> int:
    if following is None or following.hand == _BOTH:
        return stroke.hand
    return following.hand


def _stroke(
    hands: Hands, start: int, stroke: _Event, following: _Event | None, radius: float
) -> tuple[int, int | None]:
    """Return the frame in which a stroke releases the ball, and that of the catch."""
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
    hands: Hands, release: Indices, catch: Indices, pair: tuple[int, int], radius: float
) -> tuple[int, int | None]:
    """Return the release and the catch, if any, of the best flight with a bounce."""
    before, after = np.meshgrid(release, catch, indexing="ij")
    start = _under(hands, pair[0], radius)[before, 2] - radius
    end = _under(hands, pair[1], radius)[after, 2] - radius
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


_FLICK = 2.0  # gain in speed from wrists and fingers in a throw: a guess
_BLEND = 0.08  # s: standard deviation of the change from one hand to both: a guess


def ball_path(hands: Hands, radius: float, rest: Array) -> Array:
    """Return the path of the ball's center [m], shape (T, 3).

    A ball that no hand touches stays in place, with its center at ``rest`` [m], (3,). A
    ball that is released and not caught bounces until it comes to rest.
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
    both = np.zeros(len(hands.time))
    for hold in _holds(hands, radius):
        both[hold.first : hold.last + 1] = 1.0
    span = slice(touch.start, touch.end + 1)
    caught = np.cumsum(both[span]) > 0.0
    share = gaussian_filter1d(both[span], _BLEND * hands.rate, mode="nearest")
    before = _under(hands, touch.catcher, radius)[span]
    after = _under(hands, touch.thrower, radius)[span]
    one = np.where(caught[:, None], after, before)
    return np.asarray(one + share[:, None] * (_between(hands, radius)[span] - one))


def _between(hands: Hands, radius: float) -> Array:
    """Return the center of a ball that both palms touch [m], (T, 3)."""
    away = (radius + hands.radius) ** 2 - 0.25 * hands.gap**2
    center = hands.middle + np.sqrt(np.maximum(away, 0.0))[:, None] * hands.reach
    center[:, 2] = np.maximum(center[:, 2], radius)
    return np.asarray(center)


def _lie_until(path: Array, hands: Hands, taken: int, radius: float) -> None:
    if taken == 0:
        return
    place = np.array([*path[taken, :2], radius])
    path[:taken] = place
    fade = fading(hands.time[taken:] - hands.time[taken])
    path[taken:] += fade[:, None] * (place - path[taken])
    path[:, 2] = np.maximum(path[:, 2], radius)


def _release_velocity(hands: Hands, touch: Contact) -> Array:
    speed = hands.speed[touch.end]
    if touch.ending is Ending.STROKE:
        return np.asarray(speed[touch.thrower])
    gain = _FLICK if touch.ending is Ending.THROW else 1.0
    return np.asarray(gain * speed.mean(axis=0))


def _fly(path: Array, hands: Hands, touch: Contact, catch: int, radius: float) -> None:
    flight = slice(touch.end, catch + 1)
    time = hands.time[flight] - hands.time[touch.end]
    start, end = path[touch.end].copy(), path[catch].copy()
    low, high = start[2] - radius, end[2] - radius
    wish = _release_velocity(hands, touch)[2]
    stroke = touch.ending is Ending.STROKE
    speed = launch_speed(low, high, time[-1], wish, bouncing=stroke)
    if np.isnan(speed):
        speed = launch_speed(low, high, time[-1], wish)
    path[flight] = start + (time / time[-1])[:, None] * (end - start)
    path[flight, 2] = radius + flown(low, speed, time)


def _let_go(path: Array, hands: Hands, last: Contact, radius: float) -> None:
    start, speed = path[last.end].copy(), _release_velocity(hands, last)
    time = hands.time[last.end :] - hands.time[last.end]
    low, up = float(start[2] - radius), float(speed[2])
    path[last.end :] = start + rolled(low, up, time)[:, None] * speed
    path[last.end :, 2] = radius + flown(low, up, time)
