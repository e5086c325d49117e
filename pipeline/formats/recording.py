"""Recordings: the takes of all people in a file, and mocap, a skeleton in motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kinefilter.characters import InputError, Skeleton, State, Take
from kinefilter.characters.anthropometry import unit_hint
from kinefilter.characters.arrays import Array, Codes, Flags, runs, shown
from kinefilter.characters.gaps import absences
from kinefilter.characters.motion import nominal_step
from kinefilter.pipeline.people import Piece, Track, people_of

from .plain import counted, times_told
from .rows import MOST_FRAMES

Notes = tuple[str, ...]

FASTEST = 2000.0  # frames/s, of marker mocap
ASSUMED_FPS = 30.0
"""Frame rate [frames/s] of files without time stamps."""
LONGEST_STEP = 1.0  # s between frames, median: slower is not motion. A guess
_SHORTEST_NUMBER = 4.0  # a larger step is not in seconds: 4 ms at 250 frames/s
_UNITS = {
    "milliseconds": 1e3,
    "microseconds": 1e6,
    "ticks of 100 ns": 1e7,
    "nanoseconds": 1e9,
}
_COARSEST = 1e-4  # s: a hundredth of a frame at 100 frames/s
_LARGEST_PERSON = 10.0  # m; no person spans that, but everyone does in centimeters
FARTHEST = 10_000.0  # m; out of any sensor's range, so a farther joint is damage
_MOST_FAR = 0.05  # share of such joints; more are another unit. A guess
_FRAMES_MEASURED = 1000  # enough for a median
_FEWEST = 2  # frames of a person: a single frame has no motion
_GHOST_SHARE, _GHOST_FRAMES = 0.02, 15
"""Whoever has fewer frames, and less than this share of the main person's, is a false
detection. Guesses."""
_MOST_TIMES_LISTED = 5  # in the note on swapped people; the rest is only counted
_OTHER_BODY, _LEAP = 0.1, 0.3
"""Distances [m] between rows of one time stamp from which they are different bodies,
and from which the table may be of several people. Guesses."""
_SHARED = 0.1  # share of time stamps with such leaps from which the table has them


@dataclass(frozen=True)
class Recording:
    """The contents of a file from a sensor or its tools."""

    takes: tuple[Take, ...]  # one per person, in order of appearance
    format: str = ""  # name of the file's format (``takes.FORMATS``)
    unit: str = "m"  # the file's own unit of length
    notes: Notes = ()  # what the user should know about how it was read
    timed: bool = True  # False if the file has no time stamps

    @property
    def main(self) -> int:
        """Index of the person tracked in most frames."""
        return int(np.argmax([take.state.any(axis=1).sum() for take in self.takes]))

    def take(self, body: int | None = None) -> Take:
        """Return a person's take, from 1, or raise InputError; None is the main one."""
        if body is None:
            return self.takes[self.main]
        if not isinstance(body, int) or not 1 <= body <= len(self.takes):
            source = self.takes[0].source.removesuffix(", body 1")
            last = len(self.takes)
            known = f"expected 1 to {last}" if last > 1 else "only body 1"
            raise InputError(
                f"{source}: has no body {shown(body)}, {known}; 'kinefilter info' "
                "lists them"
            )
        return self.takes[body - 1]


_OTHER_TRACKER = (
    "the joints are not from a Kinect: the default method corrects them like --method "
    "local-pca, without what it learned about a Kinect's errors"
)


def not_by_kinect(recording: Recording) -> Recording:
    """Mark a recording as one whose joints do not come from a Kinect's tracker."""
    takes = tuple(replace(take, by_kinect=False) for take in recording.takes)
    return replace(recording, takes=takes, notes=(*recording.notes, _OTHER_TRACKER))


def at_rate(recording: Recording, fps: float | None) -> Recording:
    """Set the rate [frames/s] of a recording without time stamps, or note the default.

    Raises InputError for a rate out of range, or for any if there are time stamps.
    """
    source = recording.takes[0].source
    if fps is None:
        note = f"no time stamps in the file: {ASSUMED_FPS:g} frames a second assumed"
        note += " (--take-fps sets the rate)"
        notes = recording.notes if recording.timed else (note, *recording.notes)
        return replace(recording, notes=notes)
    if recording.timed:
        raise InputError(f"{source}: has time stamps; give no frame rate (--take-fps)")
    if not 1.0 <= fps <= FASTEST:
        raise InputError(f"--take-fps: {fps:g} frames/s, expected 1 to {FASTEST:g}")
    slower = ASSUMED_FPS / fps
    takes = tuple(replace(t, time=slower * t.time) for t in recording.takes)
    for take in takes:
        check_rate(take.time, source)
    return replace(recording, takes=takes)


def mark_missing(positions: Array, state: Codes) -> tuple[Array, Codes]:
    """Set missing joints to NaN in positions (..., 3) and to not tracked in states.

    A joint is missing if it is not tracked, not a number or exactly at the origin,
    where sensors put joints that they do not see.
    """
    seen = np.isfinite(positions).all(-1) & (positions != 0).any(-1) & (state > 0)
    state = np.where(seen, state, State.NOT_TRACKED).astype(np.uint8)
    return np.where(seen[..., None], positions, np.nan), state


def far_joints(positions: Array) -> Flags:
    """Flag joints (T, J) that are farther away than any sensor sees, if they are few.

    None is flagged if there are many, which ``check_extent`` refuses. Positions [m] are
    NaN where missing, shape (T, J, 3).
    """
    far = np.asarray((np.abs(positions) > FARTHEST).any(axis=-1))
    known = np.isfinite(positions[..., 0])
    few = far.sum() <= _MOST_FAR * known.sum()
    return far if few else np.zeros_like(far)


def far_notes(time: Array, far: Flags, skeleton: Skeleton) -> Notes:
    """Return a note on damaged joints (T, J) for the user; times [s] (T,)."""
    if not far.any():
        return ()
    joints = [skeleton.joints[j] for j in np.flatnonzero(far.any(axis=0))]
    since, some = time - time[0], np.asarray(far.any(axis=1))
    spans = [(since[k.start], since[k.stop - 1]) for k in runs(some)]
    return (
        f"over {FARTHEST:g} m away, so counted as missing: {', '.join(joints)}, "
        f"{times_told(spans)}",
    )


def takes_of_rows(
    time: Array, positions: Array, state: Codes, skeleton: Skeleton, source: str
) -> tuple[tuple[Take, ...], Notes]:
    """Return the takes in the rows of a table, and notes for the user.

    Time stamps [s] have shape (T,), positions [m] (T, J, 3), tracking states (T, J).
    The rows are one person's, unless many repeat the time stamp of another row at
    another place: then of several people. A take has no rows without anybody for long
    (``absences``). Raises InputError if they are not a take.
    """
    check_length(len(time), source)
    check_rate(time, source)
    positions, state, notes = _without_damage(time, positions, state, skeleton)
    check_extent(positions, source)
    stamps, sightings = _sightings(time, positions, state, skeleton.root)
    if sightings:
        takes, others = takes_of_people(stamps, sightings, skeleton, source)
        return takes, notes + others
    take = Take(time, positions, state, skeleton, source)
    seen = np.asarray((state > State.NOT_TRACKED).any(axis=1))
    absent = absences(time, seen)
    if not absent.any():
        return (take,), notes
    check_length(int(np.sum(~absent)), source)
    since = time - time[0]
    left_out = times_told([(since[k.start], since[k.stop - 1]) for k in runs(absent)])
    return (take.at(~absent),), (*notes, f"nobody in view, left out: {left_out}")


def _without_damage(
    time: Array, positions: Array, state: Codes, skeleton: Skeleton
) -> tuple[Array, Codes, Notes]:
    """Mark missing and damaged joints in positions and states, with notes."""
    positions, state = mark_missing(positions, state)
    far = far_joints(positions)
    state = np.where(far, np.uint8(State.NOT_TRACKED), state)
    positions = np.where(far[..., None], np.nan, positions)
    return positions, state, far_notes(time, far, skeleton)


def check_length(frames: int, source: str) -> None:
    """Raise InputError for fewer than two frames or more than MOST_FRAMES."""
    if frames < 2:
        raise InputError(
            f"{source}: has {counted(frames, 'frame')}, expected at least 2"
        )
    if frames > MOST_FRAMES:
        raise InputError(f"{source}: over {MOST_FRAMES:,} frames; cut it into parts")


def check_rate(time: Array, source: str) -> None:
    """Raise InputError if time stamps [s] are no sensor's, or too large to be exact."""
    distinct, seconds = 1 + int(np.sum(np.diff(time) > 0)), time[-1] - time[0]
    step = nominal_step(time)
    if distinct > 1 and (distinct > FASTEST * seconds + 2 or step * FASTEST < 1.0):
        raise InputError(
            f"{source}: {distinct} frames in {seconds:.3g} s, typically {step:.2g} s "
            "apart, are faster than any sensor; check the unit of the times (seconds, "
            "or 100 ns in rows of Kinect v2)"
        )
    if step > LONGEST_STEP:
        unit, factor = min(_UNITS.items(), key=lambda u: abs(np.log(30 * step / u[1])))
        hint = f"the time stamps look like {unit}: divide them by {factor:.0f}"
        hint = hint if step > _SHORTEST_NUMBER else "record more frames"
        raise InputError(
            f"{source}: frames are {step:.4g} s apart, expected at most "
            f"{LONGEST_STEP:g} s; {hint}"
        )
    latest = max(time[0], time[-1], key=abs)
    spacing = np.spacing(abs(latest))
    if spacing > _COARSEST:
        raise InputError(
            f"{source}: the time stamps, up to {latest:.4g} s, are too large to be "
            f"exact (they are rounded to {spacing:.2g} s); subtract the first from all"
        )


def check_extent(positions: Array, source: str) -> None:
    """Raise InputError if no joint is tracked, or any is too far away for a person."""
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
    far = np.flatnonzero(distance > FARTHEST)
    if len(far):
        raise InputError(
            f"{source}: frame {seen[far[0]] + 1} has a joint {distance[far[0]]:.3g} m "
            "away, out of range of any sensor; correct or delete it, or convert to "
            "meters"
        )


@dataclass(frozen=True, eq=False)
class Sighting:
    """A body in a frame."""

    frame: int
    body: int  # the tracker's number for the body
    positions: Array  # of joints [m], shape (J, 3)
    state: Codes  # tracking states (State), shape (J,)
    face: Array | None = None  # unit vector to where it looks, (3,); NaN if unknown


def _sightings(
    time: Array, positions: Array, state: Codes, root: int
) -> tuple[Array, list[Sighting]]:
    """Return time stamps and the bodies at each; none if all are one person's."""
    stamps, frames = np.unique(time, return_inverse=True)
    known = ~np.isnan(positions[..., :1])
    count = np.maximum(known.sum(axis=1), 1)
    places = np.where(known, positions, 0.0).sum(axis=1) / count
    places = np.where(known[:, root], positions[:, root], places)
    leaps = np.linalg.norm(np.diff(places, axis=0), axis=1) > _LEAP
    if np.sum(leaps & (np.diff(time) == 0)) <= max(_SHARED * len(stamps), _FEWEST):
        return stamps, []
    sightings: list[Sighting] = []
    rows: list[int] = []  # of the bodies at the current time stamp
    for row in np.flatnonzero(known.any(axis=(1, 2))).tolist():
        if rows and frames[rows[0]] != frames[row]:
            rows = []
        if all(np.linalg.norm(places[row] - places[k]) > _OTHER_BODY for k in rows):
            body = Sighting(int(frames[row]), len(rows), positions[row], state[row])
            sightings.append(body)
            rows.append(row)
    return stamps, sightings


def takes_of_people(
    time: Array, sightings: Sequence[Sighting], skeleton: Skeleton, source: str
) -> tuple[tuple[Take, ...], Notes]:
    """Return the takes of several people, in order of appearance, and notes.

    The tracker's numbers are only a hint at who is who (``people``). A take goes from
    its person's first frame to the last, without long gaps. Sightings are in the order
    of the frames, whose time stamps [s] have shape (T,). Raises InputError if no one is
    tracked, a body is in a frame twice, or a take is malformed.
    """
    joints = len(skeleton)
    check_length(len(time), source)
    check_rate(time, source)
    frames = np.array([sighting.frame for sighting in sightings], dtype=np.intp)
    rows_of: dict[int, list[int]] = {}
    for row, sighting in enumerate(sightings):
        others = rows_of.setdefault(sighting.body, [])
        if others and frames[others[-1]] == sighting.frame:
            where = f"{source}: frame {sighting.frame + 1}"
            raise InputError(f"{where} has body {sighting.body} twice; delete one")
        others.append(row)
    positions, state, notes = _without_damage(
        time[frames],
        np.reshape([sighting.positions for sighting in sightings], (-1, joints, 3)),
        np.reshape([sighting.state for sighting in sightings], (-1, joints)),
        skeleton,
    )
    bodies = [np.array(body) for body in rows_of.values()]
    tracks = [Track(time[frames[b]], positions[b], skeleton) for b in bodies]
    for track in tracks:
        if np.isfinite(track.positions).any():
            check_extent(track.positions, source)
    found = [
        (pieces, np.concatenate([bodies[piece.track][piece.rows] for piece in pieces]))
        for pieces in people_of(tracks)
    ]
    longest = max((len(rows) for _, rows in found), default=0)
    fewest = max(_FEWEST, min(_GHOST_SHARE * longest, _GHOST_FRAMES))
    people = [(pieces, rows) for pieces, rows in found if len(rows) >= fewest]
    if not people:
        raise InputError(
            f"{source}: no one is tracked for two frames or more; record again with "
            "the person in view"
        )
    takes = []
    for number, (_, rows) in enumerate(people, start=1):
        name = f"{source}, body {number}" if len(people) > 1 else source
        seen = frames[rows]
        span = np.arange(seen[0], seen[-1] + 1)
        span = span[~absences(time[span], np.isin(span, seen))]
        places = np.full((len(span), joints, 3), np.nan)
        states = np.zeros(places.shape[:2], dtype=np.uint8)
        tracked = np.searchsorted(span, seen)
        places[tracked], states[tracked] = positions[rows], state[rows]
        check_extent(places, name)
        face = None
        if sightings[rows[0]].face is not None:
            face = np.full((len(span), 3), np.nan)
            face[tracked] = [sightings[row].face for row in rows]
        takes.append(Take(time[span], places, states, skeleton, name, face=face))
    changes = _change_notes([pieces for pieces, _ in people], tracks)
    return tuple(takes), notes + changes


def _change_notes(people: Sequence[Sequence[Piece]], tracks: Sequence[Track]) -> Notes:
    begin = min(float(track.time[0]) for track in tracks)
    changes = sorted(
        float(tracks[piece.track].time[piece.rows[0]]) - begin
        for pieces in people
        for last, piece in pairwise(pieces)
        if last.track != piece.track
    )
    if not changes:
        return ()
    times = ", ".join(f"{time:.1f}" for time in changes[:_MOST_TIMES_LISTED])
    others = len(changes) - _MOST_TIMES_LISTED
    more = f" and {others} more times" if others > 0 else ""
    return (
        f"the tracker's numbers for people change at {times} s{more}: people were told "
        "apart by place, time and body lengths",
    )


@dataclass(frozen=True, eq=False)
class Mocap:
    """Joints in motion, in the file's own axes and unit."""

    names: tuple[str, ...]
    positions: Array  # of the joints, NaN where missing, shape (T, N, 3)
    rotations: Array | None  # of each joint in the world, wxyz, (T, N, 4), if known
    frame_time: float  # between frames [s]
    source: str
    confidence: Array | None = None  # in each joint, 0 to 1, shape (T, N), if known
    time: Array | None = None  # of the frames [s], (T,), if uneven or not from 0
    notes: tuple[str, ...] = ()  # what the reader found

    @property
    def stamps(self) -> Array:
        """Time of each frame [s], shape (T,)."""
        if self.time is not None:
            return self.time
        return np.arange(len(self.positions), dtype=np.float64) * self.frame_time

    @property
    def bare_names(self) -> list[str]:
        """Names of the joints without a prefix for the subject or rig."""
        return [name.rpartition(":")[2].strip() for name in self.names]
