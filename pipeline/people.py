"""Who is who: the tracks that sensors give of bodies, put together person by person.

A tracker numbers bodies, but takes one for another where they pass, and gives new
numbers to those who come back. So its tracks are cut wherever that may have happened:
where a body leaps or is lost, and where two are nearest to each other. The pieces are
given to people in the order of time, those that begin together all at once (Kuhn's
assignment), by the negative log likelihood of where a person would be by then, of the
lengths of the body, and of where other sensors see the person at the same time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Indices, runs
from kinefilter.pipeline.reliability import column_medians, segment_lengths

# Chosen on simulated people of seeds 40 to 55 and on p00 to p08 of two-kinects.
_LOST = 0.25  # s without a body, from which on it may be somebody else
_LEAP, _FAST = 0.1, 3.0  # m, and m/s beyond it, that bodies do not move in a step
_NEAR = 0.6  # m from each other at which bodies may be exchanged
_END = 0.4  # s at either end of a piece that tell where a person comes from and goes
_PLACE, _SPREAD, _ROOM = 0.08, 0.6, 2.0
"""Deviation of where a person is from where they would be [m], how it grows [m/s], and
at most: people come back anywhere."""
_SPEED, _CHANGE = 0.25, 1.0
"""The same of their velocity [m/s], and how it grows [m/s^2]."""
_SIDES = ("Elbow", "Wrist", "Knee", "Ankle")
_DEVIATIONS = np.array([0.024, 0.014, 0.02, 0.017, 0.02, 0.013, 0.03])
"""Of these lengths, trunk, neck and how high the head is over the feet [m], between two
pieces of a person."""
_BRIEF = 1.0  # s of a piece whose lengths deviate by as much again
_TOGETHER = 2.0  # lengths are off together: by this they count less than by themselves
_STRANGER = 9.0  # what a piece may cost before it is of somebody new
_ACROSS, _APART = 0.15, 0.8  # m by which sensors place one person apart; at most
_ENOUGH = 300  # frames of a piece that are measured
_IMPOSSIBLE = 1e6
_MOST = 1000  # cuts: who is who after them takes seconds


class Track(NamedTuple):
    """What a sensor's tracker takes for one person."""

    time: Array
    """Time stamps [s], never decreasing, (T,)."""
    positions: Array
    """Joints [m], y up, in the frame of all tracks, NaN where missing, (T, J, 3)."""
    skeleton: Skeleton
    """The joints."""
    sensor: int = 0
    """Which sensor it is of."""


class Part(NamedTuple):
    """Frames of a track that are of one person."""

    track: int
    """Number of the track, from 0."""
    rows: Indices
    """The frames, in their order."""


def people_of(tracks: Sequence[Track]) -> list[list[Part]]:
    """Return the parts of tracks that are of each person, in the order of time.

    People are in the order in which they appear. Frames without any joint are nobody's.
    Of a sensor, nobody has two parts at the same time. Tracks that leap so often that
    nothing tells who is who are a person each.
    """
    pieces, telling = _pieces(tracks)
    if not telling:
        return [[Part(piece.track, piece.rows)] for piece in pieces]
    left = sorted(pieces, key=lambda piece: piece.start)
    people: list[list[_Piece]] = []
    while left:
        group = _beginning(left)
        left = [piece for piece in left if piece not in group]
        costs = [[_cost(person, piece) for person in people] for piece in group]
        new = np.full((len(group), len(group)), _IMPOSSIBLE)
        np.fill_diagonal(new, _STRANGER + 2.0 * np.log(_ROOM))
        known = np.array(costs).reshape(len(group), len(people))
        for row, column in zip(
            *linear_sum_assignment(np.hstack([known, new])), strict=True
        ):
            if column < len(people):
                people[column].append(group[row])
            else:
                people.append([group[row]])
    return [[Part(piece.track, piece.rows) for piece in person] for person in people]


@dataclass(frozen=True, eq=False)
class _Piece:
    """Frames of a track in which nobody can have been exchanged."""

    track: int
    sensor: int
    rows: Indices
    time: Array
    places: Array  # over the floor [m], (T, 2)
    lengths: Array  # of segments [m], (K,)

    @property
    def start(self) -> float:
        return float(self.time[0])

    @property
    def end(self) -> float:
        return float(self.time[-1])

    @cached_property
    def entry(self) -> tuple[Array, Array]:
        """Where the person is at first [m], and the velocity [m/s]."""
        return _going(self.time, self.places, self.start)

    @cached_property
    def exit(self) -> tuple[Array, Array]:
        """The same at last."""
        return _going(self.time, self.places, self.end)


def _going(time: Array, places: Array, when: float) -> tuple[Array, Array]:
    near = np.abs(time - when) <= _END
    time, places = time[near] - when, places[near]
    if np.ptp(time) < 0.5 * _END:
        return places[np.argmin(np.abs(time))], np.full(2, np.nan)
    velocity, place = np.polyfit(time, places, 1)
    return place, velocity


def _pieces(tracks: Sequence[Track]) -> tuple[list[_Piece], bool]:
    """Return tracks cut wherever somebody may be somebody else from there on.

    Uncut where that is too often, and whether it is not.
    """
    seen, places, cuts = [], [], list[set[int]]()
    for track in tracks:
        known = ~np.isnan(track.positions[..., 0])
        rows = np.flatnonzero(known.any(axis=1))
        count = known[rows].sum(axis=1)[:, None]
        seen.append(rows)
        places.append(np.nansum(track.positions[rows][..., ::2], axis=1) / count)
        step = np.diff(track.time[rows])
        moved = np.linalg.norm(np.diff(places[-1], axis=0), axis=1)
        usual = float(np.median(step)) if len(step) else 0.0
        broken = (step > max(_LOST, 2.5 * usual)) | (moved > _LEAP + _FAST * step)
        cuts.append(set((np.flatnonzero(broken) + 1).tolist()))
    for k, m in combinations(range(len(tracks)), 2):
        if tracks[k].sensor == tracks[m].sensor:
            times, others = (tracks[n].time[seen[n]] for n in (k, m))
            _, one, other = np.intersect1d(times, others, return_indices=True)
            at = _exchanges(places[k][one], places[m][other])
            cuts[k].update(one[at].tolist())
            cuts[m].update(other[at].tolist())
    telling, found = sum(map(len, cuts)) <= _MOST, []
    for k, track in enumerate(tracks):
        every = np.arange(len(seen[k]))
        for part in np.split(every, sorted(cuts[k]) if telling else []):
            if len(part):
                rows = seen[k][part]
                some = rows[:: 1 + len(rows) // _ENOUGH]
                lengths = _lengths(track.positions[some], track.skeleton)
                place, time = places[k][part], track.time[rows]
                found.append(_Piece(k, track.sensor, rows, time, place, lengths))
    return found, telling


def _exchanges(one: Array, other: Array) -> Indices:
    """Return the frames from which on two may be each other, by their places [m].

    There each goes on from where the other was, or they are nearest to each other.
    """
    apart = np.linalg.norm(one - other, axis=1)
    steps = [
        np.linalg.norm(a[1:] - b[:-1], axis=1)
        for a, b in ((one, one), (other, other), (one, other), (other, one))
    ]
    found = 1 + np.flatnonzero(steps[2] + steps[3] < steps[0] + steps[1])
    for spell in runs(apart < _NEAR):
        if not ((found >= spell.start) & (found < spell.stop)).any():
            found = np.append(found, spell.start + np.argmin(apart[spell]))
    return found


def _lengths(positions: Array, skeleton: Skeleton) -> Array:
    """Return lengths that tell people apart [m], medians over frames, (K,)."""
    lengths = segment_lengths(positions, skeleton)
    pairs = [lengths[:, skeleton.sides(part)] for part in _SIDES]
    columns = [0.5 * (left + right) for left, right in (pair.T for pair in pairs)]
    girdle = positions[:, skeleton.girdle]
    for joint in (skeleton.root, skeleton.index("Head")):
        columns.append(np.linalg.norm(positions[:, joint] - girdle, axis=1))
    heights = positions[..., 1]
    feet = np.fmin.reduce(heights[:, skeleton.sides("Ankle")], axis=1)
    columns.append(heights[:, skeleton.index("Head")] - feet)
    return column_medians(np.stack(columns, axis=1))


def _beginning(left: Sequence[_Piece]) -> list[_Piece]:
    """Return the first piece and those of its sensor that begin while it is seen."""
    group = [left[0]]
    for piece in left[1:]:
        if piece.sensor == group[0].sensor:
            if not all(_overlap(piece, other) for other in group):
                break
            group.append(piece)
    return group


def _overlap(one: _Piece, other: _Piece) -> bool:
    return one.start <= other.end and other.start <= one.end


def _cost(person: Sequence[_Piece], piece: _Piece) -> float:
    """Return how unlikely it is that a piece is of a person."""
    both = [other for other in person if _overlap(other, piece)]
    if any(other.sensor == piece.sensor for other in both):
        return _IMPOSSIBLE
    cost = _of_another_body(person, piece)
    if both:
        apart = np.concatenate([_apart(piece, other) for other in both])
        distance = float(np.median(apart)) if len(apart) else 0.0
        if distance > _APART:
            return _IMPOSSIBLE
        return cost + 0.5 * (distance / _ACROSS) ** 2 + 2.0 * float(np.log(_ACROSS))
    before = [other for other in person if other.end < piece.start]
    if not before:
        return _IMPOSSIBLE
    last = max(before, key=lambda other: other.end)
    gap = piece.start - last.end
    (place, velocity), (there, goes) = last.exit, piece.entry
    # The mean of both velocities leads over a short gap; a long one tells nothing.
    speeds = np.array([velocity, goes])
    known = ~np.isnan(speeds[:, 0])
    leads = speeds[known].mean(axis=0) if known.any() else np.zeros(2)
    away = there - place - leads * (1.0 - np.exp(-gap))
    wide = min(_PLACE + _SPREAD * gap, _ROOM)
    cost += 0.5 * float(away @ away) / wide**2 + 2.0 * float(np.log(wide))
    if not known.all():
        return cost
    change = goes - velocity
    return cost + 0.5 * float(change @ change) / (_SPEED + _CHANGE * gap) ** 2


def _apart(piece: _Piece, other: _Piece) -> Array:
    """Return how far two sensors see people apart while both see them [m]."""
    inside = (piece.time >= other.start) & (piece.time <= other.end)
    there = [np.interp(piece.time[inside], other.time, x) for x in other.places.T]
    return np.asarray(np.hypot(*(piece.places[inside].T - there)))


def _of_another_body(person: Sequence[_Piece], piece: _Piece) -> float:
    """Return how unlikely the lengths of a piece are, as the same sensor sees them."""
    own = [other for other in person if other.sensor == piece.sensor]
    if not own:
        return 0.0
    counts = np.array([min(len(other.rows), _ENOUGH) for other in own], dtype=float)
    lengths = np.array([other.lengths for other in own])
    known = np.where(np.isnan(lengths), 0.0, counts[:, None])
    whole = known.sum(axis=0)
    usual = (known * np.nan_to_num(lengths)).sum(axis=0) / np.maximum(whole, 1.0)
    seconds = [max(sum(p.end - p.start for p in some), 0.1) for some in (own, [piece])]
    variance = _DEVIATIONS**2 * (1.0 + sum(_BRIEF / s for s in seconds))
    off = np.where(whole > 0.0, (piece.lengths - usual) ** 2 / variance, 0.0)
    return 0.5 * float(np.nansum(off)) / _TOGETHER
