"""Several people in one recording: whose body is whose, through gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.arrays import Array

from .recording import check_extent, check_length, check_rate, missing_marked

_AWAY = 2.0
"""A body that is new within this time [s] may be one that was lost. A guess."""
_NEAR = 0.5
"""It is where it is new within this distance [m] of where the other was lost, the
mean of the joints compared: half a stride. A guess."""
_FEWEST = 2
"""Frames of a person at least; what is seen once moves nothing."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """A body in a frame."""

    frame: int
    """Index of the frame."""
    body: int
    """The tracker's number for the body."""
    positions: Array
    """Joint positions [m], shape (J, 3)."""
    state: NDArray[np.uint8]
    """Tracking states (State), shape (J,)."""


def takes_of(
    time: Array, sightings: Sequence[Sighting], skeleton: Skeleton, source: str
) -> tuple[Take, ...]:
    """Return a take for every person, in the order in which they appear.

    A person is the bodies of one number, and those that are new near to where and soon
    after one was lost. A take goes from the first frame of its person to the last; in
    frames between that do not have the person, every joint is missing.

    Args:
        time: Time stamp of every frame of the recording [s], shape (T,).
        sightings: The bodies in it, in the order of the frames.
        skeleton: The joints.
        source: The file, for messages.

    Raises:
        InputError: Nobody is seen, a body is in a frame twice, or it is no take.
    """
    check_length(len(time), source)
    check_rate(time, source)
    people = [p for p in _people(time, sightings, source) if len(p) >= _FEWEST]
    if not people:
        raise InputError(
            f"{source}: nobody is tracked for two frames or more; record again with "
            "the person in view"
        )
    return tuple(
        _take(
            time,
            person,
            skeleton,
            source if len(people) == 1 else f"{source}, body {number}",
        )
        for number, person in enumerate(people, start=1)
    )


def _people(
    time: Array, sightings: Sequence[Sighting], source: str
) -> list[list[Sighting]]:
    """Return the sightings of each person, who appears first first."""
    tracks: dict[int, list[Sighting]] = {}
    for sighting in sightings:
        track = tracks.setdefault(sighting.body, [])
        if track and track[-1].frame == sighting.frame:
            raise InputError(
                f"{source}: frame {sighting.frame + 1} has body {sighting.body} twice; "
                "delete one of them"
            )
        track.append(sighting)
    parts = list(tracks.values())
    after = _continued(time, parts)
    people = []
    for k in sorted(set(range(len(parts))) - set(after.values())):
        person = list(parts[k])
        while k in after:
            k = after[k]
            person += parts[k]
        people.append(person)
    return people


def _continued(time: Array, parts: list[list[Sighting]]) -> dict[int, int]:
    """Return which part goes on after which, the nearest pairs first."""
    pairs = []
    for k, lost in enumerate(parts):
        for m, new in enumerate(parts):
            gap = time[new[0].frame] - time[lost[-1].frame]
            if new[0].frame > lost[-1].frame and gap <= _AWAY:
                away = float(np.linalg.norm(_place(new[0]) - _place(lost[-1])))
                if away <= _NEAR:
                    pairs.append((away, k, m))
    after: dict[int, int] = {}
    for _, k, m in sorted(pairs):
        if k not in after and m not in after.values():
            after[k] = m
    return after


def _place(sighting: Sighting) -> Array:
    """Return the mean of the joints that are seen [m], NaN without one."""
    positions, _ = missing_marked(sighting.positions, sighting.state)
    known = positions[~np.isnan(positions[:, 0])]
    return known.mean(axis=0) if len(known) else np.full(3, np.nan)


def _take(time: Array, person: list[Sighting], skeleton: Skeleton, source: str) -> Take:
    first, last = person[0].frame, person[-1].frame
    shape = (last - first + 1, len(skeleton))
    positions = np.full((*shape, 3), np.nan)
    state = np.full(shape, State.NOT_TRACKED, dtype=np.uint8)
    rows = np.array([sighting.frame for sighting in person]) - first
    positions[rows], state[rows] = missing_marked(
        np.array([sighting.positions for sighting in person]),
        np.array([sighting.state for sighting in person]),
    )
    check_extent(positions, source)
    return Take(time[first : last + 1], positions, state, skeleton, source)
