"""When hands have a ball: holds with both, strokes of dribbling with one.

The hands were not moved for the ball, so it leaves the hand of a stroke and comes back
in those frames in which a flying ball fits the hands best.
"""

from __future__ import annotations

from enum import Enum
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from kinefilter.characters.arrays import Array
from kinefilter.retarget.runs import runs

from .flight import flown, launch_speed
from .hands import Hands
from .puppet import LEFT, RIGHT

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
