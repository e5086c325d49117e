"""How often people are exchanged who pass each other, or leave and come back.

    python tests/people_figures.py --seeds 200 260
    python tests/people_figures.py --recorded ../shared/data/two-kinects

Two simulated people walk through a room, cross in its middle, leave the view, and come
back three times where they left it. Who is behind the other is often lost, and the
tracker's numbers are kept, exchanged or new at random, after crossings and when people
come back. ``--recorded`` tells of takes of pairs how far both sensors of a session see
the merged person apart, how fast that goes, and whose body it has.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from kinefilter.characters import KINECT_V2, Body, InputError, Motion
from kinefilter.characters.rotations import about_y, multiply, rotate
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.lab.view_sessions import find_sessions
from kinefilter.pipeline.merge import merge
from kinefilter.pipeline.people import Track, people_of
from kinefilter.pipeline.reliability import segment_lengths
from kinefilter.scenes.library import perform, random_body
from kinefilter.scenes.sensor import SENSORS, in_world_frame, observe

Array = NDArray[np.float64]
_FPS = 30.0
_VISITS = 4  # of the room, so that people come back three times
_PASSING = (0.4, 0.8)  # m from each other, about: the shoulders' width, and twice it
_HIDDEN = 0.4  # m beside the line of sight at which who is behind is hidden
_DIFFERENT = 0.08  # m of stature


class Visits(NamedTuple):
    """What a sensor saw of two people, and who they were."""

    tracks: list[Track]
    people: list[NDArray[np.intp]]  # who is in each row of each track
    parts: list[NDArray[np.intp]]  # and in which part: two a visit


def bodies(rng: np.random.Generator, alike: bool) -> tuple[Body, Body]:
    """Return two people, of the same stature or of clearly different ones."""
    one = random_body(KINECT_V2, rng)
    while True:
        other = random_body(KINECT_V2, rng)
        sizes = [b.rest_positions[KINECT_V2.index("Head"), 1] for b in (one, other)]
        if alike:
            scale = sizes[0] / sizes[1]
            return one, replace(other, lengths=other.lengths * scale)
        if abs(sizes[0] - sizes[1]) >= _DIFFERENT:
            return one, other


def walk(body: Body, seed: int, yaw: float) -> Motion:
    """Return somebody who is in the middle of the room after half of the time."""
    act = perform("walk", body, seed=seed, fps=_FPS)
    turn = about_y(np.array(yaw))
    root = rotate(turn, act.root)
    root = root - root[len(root) // 2] * [1.0, 0.0, 1.0]
    return replace(act, root=root, rotations=multiply(turn, act.rotations))


def _aside(acts: list[Motion], rng: np.random.Generator) -> list[Motion]:
    """Return how two walk who pass each other where there is room."""
    way = (acts[0].root - acts[1].root)[[0, -1]]
    ahead = way[1] - way[0]
    aside = np.array([ahead[2], 0.0, -ahead[0]]) / np.hypot(ahead[0], ahead[2])
    aside *= 0.5 * rng.uniform(*_PASSING) * rng.choice([-1, 1])
    return [
        replace(act, root=act.root + way * aside)
        for act, way in zip(acts, (1.0, -1.0), strict=True)
    ]


def visits(seed: int, alike: bool, sensors: int = 1, anywhere: bool = False) -> Visits:
    """Return what sensors see of two people, 90 degrees apart."""
    rng = np.random.default_rng([seed, alike])
    pair, yaws = bodies(rng, alike), rng.uniform(-np.pi, np.pi, 2)
    kinds = [replace(SENSORS["v2"], azimuth=0.5 * np.pi * s) for s in range(sensors)]
    rows: list[list[tuple[int, float, Array, int, int]]] = [[] for _ in kinds]
    numbers = np.arange(2 * sensors).reshape(sensors, 2)  # of who is who, now
    start = 0.0
    for visit in range(_VISITS):
        acts = [
            walk(body, int(rng.integers(10**6)), yaw)
            for body, yaw in zip(pair, yaws, strict=True)
        ]
        count = min(map(len, acts))
        acts = [act.at(slice((len(act) - count) // 2, None)) for act in acts]
        acts = _aside([act.at(slice(count)) for act in acts], rng)
        for s, sensor in enumerate(kinds):
            if visit:
                numbers[s] = _renewed(numbers, s, rng)
            seen = np.full((2, count, len(KINECT_V2), 3), np.nan)
            for k, act in enumerate(acts):
                take = observe(
                    act, seed=int(rng.integers(10**6)), person=seed + k, sensor=sensor
                )
                frames = np.round(take.time * _FPS).astype(int).clip(max=count - 1)
                seen[k, frames] = take.positions
            changing = _hide(seen, rng)
            places = [in_world_frame(p, sensor) for p in seen]
            apart = np.linalg.norm(acts[0].root - acts[1].root, axis=1)
            crossed = int(np.argmin(apart))
            if rng.random() < 0.5:
                changing = crossed
            for t in range(count):
                if t == changing:
                    numbers[s] = _renewed(numbers, s, rng)
                for k in np.flatnonzero(~np.isnan(seen[:, t]).all(axis=(1, 2))):
                    row = (int(numbers[s, k]), start + t / _FPS, places[k][t])
                    rows[s].append((*row, int(k), 2 * visit + (t >= crossed)))
        start += count / _FPS + rng.uniform(1.0, 20.0)
        if anywhere:
            yaws = rng.uniform(-np.pi, np.pi, 2)
        else:
            yaws = yaws + np.pi + rng.normal(0.0, 0.3, 2)
    tracks, people, parts = [], [], []
    for s, some in enumerate(rows):
        for number in sorted({row[0] for row in some}):
            of = [row for row in some if row[0] == number]
            time, joints = np.array([r[1] for r in of]), np.array([r[2] for r in of])
            tracks.append(Track(time, joints, KINECT_V2, s))
            people.append(np.array([row[3] for row in of]))
            parts.append(np.array([row[4] for row in of]))
    return Visits(tracks, people, parts)


def _renewed(numbers: NDArray[np.intp], s: int, rng: np.random.Generator) -> Array:
    """Return a sensor's numbers of two people: kept, exchanged, or new."""
    new = int(numbers.max()) + 1 + np.arange(2)
    kept = numbers[s].copy()
    chosen = [kept, kept[::-1], new, [kept[0], new[0]], [new[0], kept[1]]]
    return np.array(chosen[int(rng.integers(len(chosen)))])


def _hide(seen: Array, rng: np.random.Generator) -> int:
    """Lose who is behind the other, mostly, in the sensor's frame; return when."""
    roots = seen[:, :, KINECT_V2.root]
    bearing, depth = roots[..., 0] / roots[..., 2], roots[..., 2]
    beside = np.abs(bearing[0] - bearing[1]) * depth.min(axis=0)
    near = beside < _HIDDEN
    if rng.random() < 0.7:
        for k in (0, 1):
            seen[k, near & (depth[k] > depth[1 - k])] = np.nan
    return int(np.argmin(np.nan_to_num(beside, nan=np.inf)))


def exchanged(given: Visits, found: Sequence[Sequence[tuple[int, int]]]) -> Counter:
    """Count what became of people after crossings, and when they came back.

    ``found`` are the tracks and rows of each person.
    """
    names: dict[tuple[int, int], Counter] = {}
    for name, rows in enumerate(found):
        for track, row in rows:
            key = int(given.people[track][row]), int(given.parts[track][row])
            names.setdefault(key, Counter())[name] += 1
    counted: Counter = Counter()
    for before, after in pairwise(range(2 * _VISITS)):
        kind = "crossing" if after % 2 else "coming back"
        keys = [[(k, part) for part in (before, after)] for k in (0, 1)]
        if not all(key in names for pair in keys for key in pair):
            continue
        name = [[names[key].most_common(1)[0][0] for key in pair] for pair in keys]
        was, now = zip(*name, strict=True)
        counted[kind] += 1
        if was[0] == now[1] or was[1] == now[0]:
            counted[f"{kind}, exchanged"] += 1
        elif was != now:
            counted[f"{kind}, somebody new"] += 1
    return counted


def tell(seeds: range, sensors: int, anywhere: bool) -> None:
    """Print how often people are exchanged."""
    table = Table("stature", "who is who by", "event", "events", "exchanged", "new")
    for alike in (False, True):
        by: dict[str, Counter] = {"the tracker": Counter(), "kinefilter": Counter()}
        for seed in seeds:
            given = visits(seed, alike, sensors, anywhere)
            every = [
                [(k, row) for row in range(len(track.time))]
                for k, track in enumerate(given.tracks)
            ]
            by["the tracker"] += exchanged(given, every)
            parts = [
                [(part.track, int(row)) for part in person for row in part.rows]
                for person in people_of(given.tracks)
            ]
            by["kinefilter"] += exchanged(given, parts)
        for who, counted in by.items():
            for kind in ("crossing", "coming back"):
                table.add_row(
                    "same" if alike else "different",
                    who,
                    kind,
                    str(counted[kind]),
                    str(counted[f"{kind}, exchanged"]),
                    str(counted[f"{kind}, somebody new"]),
                )
    out.print(table)


def tell_recorded(folder: Path) -> None:
    """Print how people fare in sessions of pairs, of whom each file has both."""
    headings = ("both see, %", "apart, cm", "over 40 cm, %", "fastest, m/s")
    table = Table("session", "body", *headings, "thigh and shin off, %")
    for session in find_sessions([folder], None):
        recordings = [read_recording(path) for path in (session.first, session.second)]
        if all(len(recording.takes) == 1 for recording in recordings):
            continue
        for body in range(1, 1 + len(recordings[0].takes)):
            try:
                merged = merge(recordings, body=body)
            except InputError as refused:
                table.add_row(session.name, str(body), str(refused)[-60:])
                continue
            take, root = merged.take, merged.take.skeleton.root
            apart = np.linalg.norm(np.ptp(np.stack(merged.seen)[:, :, root], 0), axis=1)
            known = ~np.isnan(apart)
            if not known.any():
                table.add_row(session.name, str(body), "one sensor sees them")
                continue
            places = take.positions[:, root, ::2]
            speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(take.time)
            legs = take.skeleton.sides("Knee") + take.skeleton.sides("Ankle")
            leg = segment_lengths(take.positions, take.skeleton)[:, legs].mean(axis=1)
            leg = leg[~np.isnan(leg)]
            off = np.abs(leg / np.nanmedian(leg) - 1.0)
            numbers = (100.0 * known.mean(), 100.0 * np.median(apart[known]))
            jumps = (100.0 * np.mean(apart[known] > 0.4), np.nanmax(speed))
            row = (*numbers, *jumps, 100.0 * np.nanmedian(off))
            table.add_row(session.name, str(body), *(f"{x:.1f}" for x in row))
    out.print(table)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(200, 260))
    parser.add_argument("--sensors", type=int, default=1)
    parser.add_argument("--anywhere", action="store_true")
    parser.add_argument("--recorded", type=Path)
    options = parser.parse_args()
    if options.recorded is not None:
        tell_recorded(options.recorded)
    else:
        tell(range(*options.seeds), options.sensors, options.anywhere)


if __name__ == "__main__":
    main()
