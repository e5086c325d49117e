"""What a recorded file holds: a take of every person, or a skeleton in motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from kinefilter.characters import InputError, Skeleton, State, Take, unit_hint
from kinefilter.characters.arrays import Array, Codes, shown
from kinefilter.characters.gaps import LONG_GAP
from kinefilter.characters.motion import nominal_step

from .files import open_text
from .plain import counted

if TYPE_CHECKING:
    from kinefilter.pipeline.people import Part, Track

_Path = TypeVar("_Path", bound=PurePath)

MOST_FRAMES = 1_000_000  # of a recording: nine hours at 30 a second
FASTEST = 2000.0  # frames a second, of marker mocap
ASSUMED_FPS = 30.0
"""Frames a second of files that have no time stamps."""
_LONGEST_STEP = 1.0  # s between frames, in the median: less is no motion. A guess
_SHORTEST_NUMBER = 4.0  # of a step that is not in seconds: ms at 250 frames a second
_UNITS = {"milliseconds": 10**3, "microseconds": 10**6, "ticks of 100 ns": 10**7}
_UNITS["nanoseconds"] = 10**9
_COARSEST = 1e-4  # s: a hundredth of a frame of 100 a second
_LARGEST_PERSON = 10.0  # m; no one spans that, in centimeters everyone does
FARTHEST = 10_000.0  # m; no sensor sees that far, a damaged number may say so
_FRAMES_MEASURED = 1000  # enough for a median
FRAMES_AT_ONCE = 1000  # that are written: about a megabyte of text
_FEWEST = 2  # frames of a person; what is seen once moves nothing
_GHOST, _BRIEF = 0.02, 15
"""Share of the frames of who is seen most, and frames, under which what is seen is a
leap of the tracker and nobody. Guesses."""
_TOLD = 5  # times of changes; of more their number says enough
_OTHER, _BESIDE = 0.1, 0.3
"""Distance [m] of bodies of one time stamp that are not the same, and that nobody moves
from one row to the next. Guesses."""
_SHARED = 0.1  # of the time stamps, from which on a table has several people's rows


@dataclass(frozen=True)
class Recording:
    """A file that a sensor or its tools wrote."""

    takes: tuple[Take, ...]  # one a person, in the order in which they appear
    format: str  # name of the file's layout (``takes.FORMATS``)
    unit: str = "m"  # the file's own unit of length
    notes: tuple[str, ...] = ()  # what the user should know about how it was read
    timed: bool = True  # whether the time stamps are the file's own

    @property
    def main(self) -> int:
        """Index of the person who is seen in most frames."""
        seen = [(take.state > State.NOT_TRACKED).any(axis=1) for take in self.takes]
        return int(np.argmax([frames.sum() for frames in seen]))

    def numbers(self, body: int | Literal["all"] | None) -> list[int]:
        """Return the numbers, from 1, of those asked for; None: the main person."""
        if body == "all":
            return list(range(1, len(self.takes) + 1))
        return [self.main + 1 if body is None else body]

    def take(self, body: int | None = None) -> Take:
        """Return a person's take, from 1, or raise InputError; None: the main one."""
        if body is None:
            return self.takes[self.main]
        if not isinstance(body, int) or not 1 <= body <= len(self.takes):
            raise InputError(
                f"{self.takes[0].source}: has no body {shown(body)}, only "
                f"{len(self.takes)}; 'kinefilter info' lists them"
            )
        return self.takes[body - 1]


_OTHER_TRACKER = (
    "not a Kinect's joints: the default corrects them as --method local-pca does, "
    "without what it learned of a Kinect's errors"
)


def of_other_tracker(recording: Recording) -> Recording:
    """Return a recording whose joints no Kinect's tracker put where they are."""
    takes = tuple(replace(take, by_kinect=False) for take in recording.takes)
    return replace(recording, takes=takes, notes=(*recording.notes, _OTHER_TRACKER))


def at_rate(recording: Recording, fps: float | None) -> Recording:
    """Return a recording without time stamps at so many frames a second, or as assumed.

    Raises InputError if it has time stamps, and a rate is given all the same.
    """
    source = recording.takes[0].source
    if fps is None:
        told = f"no time stamps in the file: {ASSUMED_FPS:g} frames a second assumed"
        notes = recording.notes if recording.timed else (told, *recording.notes)
        return replace(recording, notes=notes)
    if recording.timed:
        raise InputError(f"{source}: has time stamps; leave --take-fps out")
    if not 1.0 <= fps <= FASTEST:
        raise InputError(f"--take-fps {fps:g}: expected 1 to {FASTEST:g} frames/s")
    takes = tuple(
        replace(take, time=take.time * (ASSUMED_FPS / fps)) for take in recording.takes
    )
    for take in takes:
        check_rate(take.time, source)
    return replace(recording, takes=takes)


def numbered(path: _Path, body: int | None) -> _Path:
    """Return the path of one of several people: ``clip.2.usda`` for ``clip.usda``."""
    if body is None:
        return path
    return path.with_name(f"{path.stem}.{body}{path.suffix}")


def part_paths(path: _Path, parts: int) -> list[_Path]:
    """Return a path for each part of a take: the path itself, or ``clip.part1.usda``.

    Of one of several people it is ``clip.2.part1.usda``.
    """
    if parts == 1:
        return [path]
    names = (f"{path.stem}.part{k}{path.suffix}" for k in range(1, parts + 1))
    return [path.with_name(name) for name in names]


@contextmanager
def open_rows(source: str) -> Iterator[tuple[int, str, Iterator[str]]]:
    """Yield number and text of a file's first filled line, and the lines after it."""
    with open_text(source) as lines:
        for row, line in enumerate(lines, start=1):
            if line.strip():
                yield row, line, lines
                return
        raise InputError(f"{source}: the file is empty; expected a recorded take")


def missing_marked(positions: Array, state: Codes) -> tuple[Array, Codes]:
    """Return positions [m] (..., 3) and states (...), NaN and not tracked if missing.

    Missing is what is not tracked, not a number or exactly at the origin, where the
    sensors put what they do not see.
    """
    seen = np.isfinite(positions).all(-1) & (positions != 0).any(-1) & (state > 0)
    known = np.where(seen, state, State.NOT_TRACKED).astype(np.uint8)
    return np.where(seen[..., None], positions, np.nan), known


def recording_of(
    time: Array,
    positions: Array,
    state: Codes,
    skeleton: Skeleton,
    source: str,
    layout: str,
    **known: Any,
) -> Recording:
    """Return the recording of a table; raises InputError where it can be none.

    Time [s] is (T,), positions [m] are (T, J, 3), states (State) are (T, J); the rest
    are fields of the take and of the recording. Rows of one person, unless many have
    the time stamp of another in another place: those are of several.
    """
    check_length(len(time), source)
    check_rate(time, source)
    positions, state = missing_marked(positions, state)
    check_extent(positions, source)
    stamps, sightings = _sightings(time, positions, state, skeleton.root)
    if sightings:
        return recording_of_people(stamps, sightings, skeleton, source, layout, **known)
    return Recording((Take(time, positions, state, skeleton, source),), layout, **known)


def check_length(frames: int, source: str) -> None:
    """Raise InputError for fewer than two frames or more than any recording's."""
    if frames < 2:
        raise InputError(
            f"{source}: has {counted(frames, 'frame')}, expected at least 2; record a "
            "longer take"
        )
    if frames > MOST_FRAMES:
        raise InputError(
            f"{source}: has more than {MOST_FRAMES:,} frames; cut it into shorter takes"
        )


def check_rate(time: Array, source: str) -> None:
    """Raise InputError for frames faster or slower than any sensor's.

    Or for time stamps [s] too far from 0 to tell frames apart; they may repeat.
    """
    distinct, seconds = 1 + int(np.sum(np.diff(time) > 0)), time[-1] - time[0]
    step = nominal_step(time)
    if distinct > 1 and (distinct > FASTEST * seconds + 2 or step * FASTEST < 1.0):
        raise InputError(
            f"{source}: {distinct} frames in {seconds:.3g} s, most {step:.2g} s apart, "
            "are more than any sensor takes; are the times in seconds?"
        )
    if step > _LONGEST_STEP:
        unit, factor = min(_UNITS.items(), key=lambda u: abs(np.log(30 * step / u[1])))
        hint = f"the time stamps look like {unit}: divide them by {factor}"
        raise InputError(
            f"{source}: frames are {step:.4g} s apart, expected {_LONGEST_STEP:g} s at "
            f"most; {hint if step > _SHORTEST_NUMBER else 'record more frames'}"
        )
    latest = max(time[0], time[-1], key=abs)
    if np.spacing(abs(latest)) > _COARSEST:
        raise InputError(
            f"{source}: numbers near the time stamp {latest:.4g} s are "
            f"{np.spacing(abs(latest)):.2g} s apart; subtract the first from all"
        )


def check_extent(positions: Array, source: str) -> None:
    """Raise InputError where nobody is seen or no one can be that tall."""
    seen = np.flatnonzero(np.isfinite(positions[..., 0]).any(axis=1))
    if not len(seen):
        raise InputError(
            f"{source}: no joint is tracked in any of {len(positions)} frames (all "
            "zero, empty or state 0); record again with the person in view"
        )
    some = positions[seen[:: 1 + len(seen) // _FRAMES_MEASURED]]
    with np.errstate(over="ignore"):
        spans = np.fmax.reduce(some, axis=1) - np.fmin.reduce(some, axis=1)
    span = float(np.median(spans.max(axis=-1)))
    if span > _LARGEST_PERSON:
        raise InputError(
            f"{source}: the skeleton spans {span:.0f} m in a typical frame, expected a "
            f"person in meters; {unit_hint(span)}"
        )
    distance = np.fmax.reduce(np.abs(positions[seen]).reshape(len(seen), -1), axis=1)
    far = seen[distance > FARTHEST]
    if len(far):
        raise InputError(
            f"{source}: frame {far[0] + 1} has a joint {distance.max():.3g} m away, "
            "expected a person before a sensor, in meters; correct or delete it"
        )


@dataclass(frozen=True, eq=False)
class Sighting:
    """A body in a frame."""

    frame: int
    body: int  # the tracker's number for the body
    positions: Array  # of joints [m], shape (J, 3)
    state: Codes  # tracking states (State), shape (J,)


def _sightings(
    time: Array, positions: Array, state: Codes, root: int
) -> tuple[Array, list[Sighting]]:
    """Return distinct time stamps, and every body at each, numbered as they come.

    No body where rows of one time are of one person, who moves little from row to row.
    """
    stamps, frames = np.unique(time, return_inverse=True)
    known = ~np.isnan(positions[..., :1])
    count = np.maximum(known.sum(axis=1), 1)
    places = np.where(known, positions, 0.0).sum(axis=1) / count
    places = np.where(known[:, root], positions[:, root], places)
    leaps = np.linalg.norm(np.diff(places, axis=0), axis=1) > _BESIDE
    if np.sum(leaps & (np.diff(time) == 0)) <= max(_SHARED * len(stamps), _FEWEST):
        return stamps, []
    found: list[Sighting] = []
    rows: list[int] = []  # of the bodies at a time stamp
    for row in np.flatnonzero(known.any(axis=(1, 2))).tolist():
        if rows and frames[rows[0]] != frames[row]:
            rows = []
        if all(np.linalg.norm(places[row] - places[k]) > _OTHER for k in rows):
            body = Sighting(int(frames[row]), len(rows), positions[row], state[row])
            found.append(body)
            rows.append(row)
    return stamps, found


def recording_of_people(
    time: Array,
    sightings: Sequence[Sighting],
    skeleton: Skeleton,
    source: str,
    layout: str,
    *,
    notes: tuple[str, ...] = (),
    **known: Any,
) -> Recording:
    """Return the recording of several people, in the order in which they appear.

    The tracker's numbers are no more than a hint at who is who (``people``). A take
    goes from its person's first frame to the last, without long gaps. Sightings are in
    the order of the frames, whose time stamps [s] have shape (T,). Raises InputError if
    nobody is seen, a body is in a frame twice, or it is not a take.
    """
    from kinefilter.pipeline.people import Track, people_of

    check_length(len(time), source)
    check_rate(time, source)
    bodies: dict[int, list[Sighting]] = {}
    for sighting in sightings:
        body = bodies.setdefault(sighting.body, [])
        if body and body[-1].frame == sighting.frame:
            raise InputError(
                f"{source}: frame {sighting.frame + 1} has body {sighting.body} twice; "
                "delete one of them"
            )
        body.append(sighting)
    tracks, frames, states = [], [], []
    for body in bodies.values():
        frames.append(np.array([sighting.frame for sighting in body]))
        positions, state = missing_marked(
            np.array([sighting.positions for sighting in body]),
            np.array([sighting.state for sighting in body]),
        )
        if state.any():
            check_extent(positions, source)
        tracks.append(Track(time[frames[-1]], positions, skeleton))
        states.append(state)
    found = people_of(tracks)
    counts = [sum(len(part.rows) for part in parts) for parts in found]
    least = max(_FEWEST, min(_GHOST * max(counts, default=0), _BRIEF))
    people = [p for p, count in zip(found, counts, strict=True) if count >= least]
    if not people:
        raise InputError(
            f"{source}: nobody is tracked for two frames or more; record again with "
            "the person in view"
        )
    takes = []
    for number, parts in enumerate(people, start=1):
        name = f"{source}, body {number}" if len(people) > 1 else source
        seen = np.concatenate([frames[part.track][part.rows] for part in parts])
        span = np.arange(seen[0], seen[-1] + 1)
        last = seen[np.searchsorted(seen, span, "right") - 1]
        gap = time[seen[np.searchsorted(seen, span)]] - time[last]
        span = span[gap <= LONG_GAP]
        rows = np.searchsorted(span, seen)
        positions = np.full((len(span), len(skeleton), 3), np.nan)
        state = np.zeros(positions.shape[:2], dtype=np.uint8)
        for values, given in (
            (positions, [track.positions for track in tracks]),
            (state, states),
        ):
            values[rows] = np.concatenate([given[p.track][p.rows] for p in parts])
        check_extent(positions, name)
        takes.append(Take(time[span], positions, state, skeleton, name))
    notes += tuple(_told(people, tracks))
    return Recording(tuple(takes), layout, notes=notes, **known)


def _told(people: Sequence[Sequence[Part]], tracks: Sequence[Track]) -> Iterator[str]:
    """Yield where the tracker has taken one person for another."""
    when = sorted(
        float(tracks[part.track].time[part.rows[0]])
        for parts in people
        for last, part in pairwise(parts)
        if last.track != part.track
    )
    if when:
        some = ", ".join(f"{time:.1f}" for time in when[:_TOLD])
        more = f" and {len(when) - _TOLD} more times" if len(when) > _TOLD else ""
        yield (
            f"the tracker's numbers of people change at {some} s{more}: people were "
            "told apart by place, time and body lengths"
        )


@dataclass(frozen=True, eq=False)
class Mocap:
    """Joints in motion, in the file's own axes and unit."""

    names: tuple[str, ...]
    positions: Array  # of the joints, NaN where missing, shape (T, N, 3)
    rotations: Array | None  # of each joint in the world, wxyz, (T, N, 4), or unknown
    frame_time: float  # between frames [s]
    source: str
    confidence: Array | None = None  # in each joint, 0 to 1, shape (T, N), or unknown

    @property
    def bare_names(self) -> list[str]:
        """Names of joints without the name of the subject or rig before them."""
        return [name.rpartition(":")[2].strip() for name in self.names]
