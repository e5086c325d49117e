"""Who is who: the tracks from sensors' trackers, joined person by person.

A tracker numbers bodies, but confuses people who pass each other and gives new numbers
to those who come back. So its tracks are cut wherever that may have happened: where a
body jumps or is lost, and where two are nearest to each other. The pieces are assigned
to people in order of time, those that begin together all at once (Kuhn's assignment).
The cost is the negative log likelihood of three things: where the person would be by
then, their segment lengths, and where other sensors see them at the same time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Indices, runs
from kinefilter.pipeline.reliability import column_medians, segment_lengths

# Chosen on simulated people of seeds 40 to 55 and on p00 to p08 of two-kinects.
_LOST = 0.25  # s without a body, after which it may be another person
_JUMP, _FAST = 0.1, 3.0  # m, and m/s on top, that bodies do not move in one step
_NEAR = 0.6  # m between bodies that may be confused
_END = 0.4  # s at either end of a piece that give its first or last motion
_PLACE, _SPREAD, _ROOM = 0.08, 0.6, 2.0
"""Standard deviation of where a person is from where they would be [m], its growth
[m/s], and its maximum: people come back anywhere."""
_SPEED, _CHANGE = 0.25, 1.0
"""Standard deviation of their velocity [m/s], and its growth [m/s^2]."""
_SIDES = ("Elbow", "Wrist", "Knee", "Ankle")
_DEVIATIONS = np.array([0.024, 0.014, 0.02, 0.017, 0.02, 0.013, 0.03])
"""Standard deviations between two pieces of one person of these lengths, of trunk and
neck, and of the height of the head above the feet [m]."""
_CUT_OFF = 9.0
"""Greatest square of that height's deviation: at the edge of the view legs are cut off.
Chosen on a take of p22; simulated people (200 to 239) are told apart as before."""
_BRIEF = 1.0  # s of a piece whose lengths have twice that variance
_TOGETHER = 2.0  # divides the cost of lengths, as their errors are correlated
_STRANGER = 9.0  # cost above which a piece belongs to a new person
_ACROSS, _APART = 0.15, 0.8  # m between one person's places by two sensors; maximum
_ENOUGH = 300  # frames of a piece that are measured
_IMPOSSIBLE = 1e6
_MOST = 1000  # cuts; assigning the pieces of more takes too long


class Track(NamedTuple):
    """The frames that a sensor's tracker takes for one person."""

    time: Array  # time stamps [s], never decreasing, (T,)
    positions: Array  # joints [m], y up, frame of all tracks, or NaN, (T, J, 3)
    skeleton: Skeleton  # the joints
    sensor: int = 0  # number of the sensor


@dataclass(frozen=True, eq=False)
class Piece:
    """Frames of a track throughout which it shows the same person."""

    track: int  # number of the track, from 0
    sensor: int
    rows: Indices  # the frames, in order
    time: Array
    places: Array  # over the floor [m], (T, 2)
    lengths: Array  # of segments [m], (K,)
    first: tuple[Array, Array]  # place [m], and velocity [m/s] or NaN, at its beginning
    last: tuple[Array, Array]  # the same at its end


def people_of(tracks: Sequence[Track]) -> list[list[Piece]]:
    """Return the pieces of the tracks for each person, in order of time.

    People are in order of appearance, without simultaneous pieces by one sensor. Frames
    without joints are no one's. Tracks that jump too often are one person each.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load

    pieces, separable = _pieces(tracks)
    if not separable:
        return [[piece] for piece in pieces]
    left = sorted(pieces, key=lambda piece: piece.time[0])
    people: list[list[Piece]] = []
    while left:
        group = _beginning(left)
        left = [piece for piece in left if piece not in group]
        costs = np.full((len(group), len(people) + len(group)), _IMPOSSIBLE)
        new = costs[:, len(people) :]  # a view: each piece may be a new person
        np.fill_diagonal(new, _STRANGER + 2.0 * np.log(_ROOM))
        for k, piece in enumerate(group):
            costs[k, : len(people)] = [_cost(person, piece) for person in people]
        people += [[] for _ in group]
        for row, column in zip(*linear_sum_assignment(costs), strict=True):
            people[column].append(group[row])
        people = [person for person in people if person]
    return people


def _motion(time: Array, places: Array, when: float) -> tuple[Array, Array]:
    """Return place [m], and velocity [m/s] or NaN, at one end of a piece."""
    near = np.abs(time - when) <= _END
    time, places = time[near] - when, places[near]
    if np.ptp(time) < 0.5 * _END:
        return places[np.argmin(np.abs(time))], np.full(2, np.nan)
    velocity, place = np.polyfit(time, places, 1)
    return place, velocity


def _pieces(tracks: Sequence[Track]) -> tuple[list[Piece], bool]:
    """Return tracks cut where the person may change; uncut, and False, if too often."""
    seen, places, cuts = [], [], list[set[int]]()
    gaps, jumps = [], []
    for track in tracks:
        present = ~np.isnan(track.positions[..., 0])
        rows = np.flatnonzero(present.any(axis=1))
        count = present[rows].sum(axis=1)[:, None]
        seen.append(rows)
        places.append(np.nansum(track.positions[rows][..., ::2], axis=1) / count)
        step = np.diff(track.time[rows])
        moved = np.linalg.norm(np.diff(places[-1], axis=0), axis=1)
        usual = float(np.median(step)) if len(step) else 0.0
        broken = (step > max(_LOST, 2.5 * usual)) | (moved > _JUMP + _FAST * step)
        cuts.append(set((np.flatnonzero(broken) + 1).tolist()))
        gaps.append(np.flatnonzero(step > 1.5 * usual) + 1)
        jumps.append(track.time[rows][1:][broken])
    for k, m in combinations(range(len(tracks)), 2):
        if tracks[k].sensor == tracks[m].sensor:
            times, others = (tracks[n].time[seen[n]] for n in (k, m))
            # Files that list bodies without numbers: one may fill the other's gap.
            cuts[k].update(_filled(times, gaps[k], jumps[m]))
            cuts[m].update(_filled(others, gaps[m], jumps[k]))
            _, one, other = np.intersect1d(times, others, return_indices=True)
            frames = _crossings(places[k][one], places[m][other])
            cuts[k].update(one[frames].tolist())
            cuts[m].update(other[frames].tolist())
    separable, found = sum(map(len, cuts)) <= _MOST, []
    for k, track in enumerate(tracks):
        frames = np.arange(len(seen[k]))
        for piece in np.split(frames, sorted(cuts[k]) if separable else []):
            if len(piece):
                rows = seen[k][piece]
                sample = rows[:: 1 + len(rows) // _ENOUGH]
                lengths = _lengths(track.positions[sample], track.skeleton)
                place, time = places[k][piece], track.time[rows]
                ends = (_motion(time, place, when) for when in (time[0], time[-1]))
                found.append(Piece(k, track.sensor, rows, time, place, lengths, *ends))
    return found, separable


def _filled(time: Array, gaps: Indices, jumps: Array) -> list[int]:
    """Return the frames after gaps during which, or after which, a body jumps [s]."""
    before = np.searchsorted(jumps, time, "right")
    return [n for n in gaps.tolist() if before[n] > before[n - 1]]


def _crossings(one: Array, other: Array) -> Indices:
    """Return the frames from which two bodies may be swapped, by their places [m].

    These are where each continues from the other's place, or they are nearest.
    """
    apart = np.linalg.norm(one - other, axis=1)
    both = np.stack([one, other])
    steps = np.linalg.norm(both[:, None, 1:] - both[:, :-1], axis=3)  # to and from
    found = 1 + np.flatnonzero(steps[0, 1] + steps[1, 0] < steps[0, 0] + steps[1, 1])
    for spell in runs(apart < _NEAR):
        if not ((found >= spell.start) & (found < spell.stop)).any():
            found = np.append(found, spell.start + np.argmin(apart[spell]))
    return found


def _lengths(positions: Array, skeleton: Skeleton) -> Array:
    """Return medians over frames of lengths that tell people apart [m], (K,)."""
    lengths = segment_lengths(positions, skeleton)
    columns = [lengths[:, skeleton.sides(part)].mean(axis=1) for part in _SIDES]
    girdle = positions[:, skeleton.girdle]
    for joint in (skeleton.root, skeleton.index("Head")):
        columns.append(np.linalg.norm(positions[:, joint] - girdle, axis=1))
    heights = positions[..., 1]
    feet = np.fmin.reduce(heights[:, skeleton.sides("Ankle")], axis=1)
    columns.append(heights[:, skeleton.index("Head")] - feet)
    return column_medians(np.stack(columns, axis=1))


def _beginning(left: Sequence[Piece]) -> list[Piece]:
    """Return the first piece, and those of its sensor that begin while it lasts."""
    group = [left[0]]
    for piece in left[1:]:
        if piece.sensor == group[0].sensor:
            if not all(_overlap(piece, other) for other in group):
                break
            group.append(piece)
    return group


def _overlap(one: Piece, other: Piece) -> bool:
    return bool(one.time[0] <= other.time[-1] and other.time[0] <= one.time[-1])


def _cost(person: Sequence[Piece], piece: Piece) -> float:
    """Return the cost of assigning a piece to a person."""
    both = [other for other in person if _overlap(other, piece)]
    if any(other.sensor == piece.sensor for other in both):
        return _IMPOSSIBLE
    cost = _cost_of_lengths(person, piece)
    if both:
        apart = np.concatenate([_distances(piece, other) for other in both])
        distance = float(np.median(apart)) if len(apart) else 0.0
        if distance > _APART:
            return _IMPOSSIBLE
        return cost + 0.5 * (distance / _ACROSS) ** 2 + 2.0 * float(np.log(_ACROSS))
    before = [other for other in person if other.time[-1] < piece.time[0]]
    if not before:
        return _IMPOSSIBLE
    last = max(before, key=lambda other: other.time[-1])
    gap = float(piece.time[0] - last.time[-1])
    (place, velocity), (there, next_velocity) = last.last, piece.first
    # Over a short gap the person moves at the mean velocity; a long one tells nothing.
    velocities = np.array([velocity, next_velocity])
    known = ~np.isnan(velocities[:, 0])
    mean = velocities[known].mean(axis=0) if known.any() else np.zeros(2)
    away = there - place - mean * (1.0 - np.exp(-gap))
    wide = min(_PLACE + _SPREAD * gap, _ROOM)
    cost += 0.5 * float(away @ away) / wide**2 + 2.0 * float(np.log(wide))
    if not known.all():
        return cost
    change = next_velocity - velocity
    return cost + 0.5 * float(change @ change) / (_SPEED + _CHANGE * gap) ** 2


def _distances(piece: Piece, other: Piece) -> Array:
    """Return distances [m] of the places of two sensors at the same times."""
    inside = (piece.time >= other.time[0]) & (piece.time <= other.time[-1])
    there = [np.interp(piece.time[inside], other.time, x) for x in other.places.T]
    return np.asarray(np.hypot(*(piece.places[inside].T - there)))


def _cost_of_lengths(person: Sequence[Piece], piece: Piece) -> float:
    """Return the cost of a piece's lengths against the person's by the same sensor."""
    own = [other for other in person if other.sensor == piece.sensor]
    if not own:
        return 0.0
    counts = np.array([min(len(other.rows), _ENOUGH) for other in own], dtype=float)
    lengths = np.array([other.lengths for other in own])
    weights = np.where(np.isnan(lengths), 0.0, counts[:, None])
    total = weights.sum(axis=0)
    mean = (weights * np.nan_to_num(lengths)).sum(axis=0) / np.maximum(total, 1.0)
    seconds = [max(sum(np.ptp(p.time) for p in some), 0.1) for some in (own, [piece])]
    variance = _DEVIATIONS**2 * (1.0 + sum(_BRIEF / s for s in seconds))
    off = np.where(total > 0.0, (piece.lengths - mean) ** 2 / variance, 0.0)
    off[-1] = min(off[-1], _CUT_OFF)
    return 0.5 * float(np.nansum(off)) / _TOGETHER
