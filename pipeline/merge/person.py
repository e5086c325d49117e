"""Finds one person in the recordings of all sensors, and where the sensors are.

Of several people, those whose movements are most alike tell where the sensors are. In
the frame of the first sensor, everyone's tracks are then assigned to people at once
(``people``): what one sensor's tracker confused, another sensor settles.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np

from kinefilter.characters import InputError, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.checks import checked_take
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.people import Piece, Track, people_of

from .alignment import IDENTITY, Alignment, align
from .rigid import Placement

_TURNED, _SHIFTED = np.radians(8.0), 0.25
"""Angle, and distance [m], by which a sensor may appear to have moved between two takes
in which people walked. Placements of the same sensor differ by up to 3 degrees and
0.1 m in two-kinects (p00 to p08)."""
_CHOSEN = 1.4  # weight of the person asked for against that of others. A guess
_TRIED = 4  # people of a recording who may tell where the sensors are


class Person(NamedTuple):
    """What each sensor that sees a person recorded, beginning with the first."""

    takes: list[Take]  # with gross failures repaired
    scores: list[Array]  # reliability of each take, (T, J)
    alignments: list[Alignment]  # of the second take, the third and so on
    notes: tuple[str, ...]  # what users should know about who is who


def find_person(
    recordings: Sequence[Recording], body: int | None, calibration: Sequence[Alignment]
) -> Person:
    """Return a person of the first recording as all sensors saw them; see ``merge``."""
    chosen = recordings[0].take(body)
    people = [_score_people(recording) for recording in recordings]
    first, alignments = people[0][0][0], []
    for k, others in enumerate(people[1:]):
        firsts, seconds = ([take for take, _ in some] for some in (people[0], others))
        found = _align_people(firsts, seconds, calibration, k, chosen)
        begin, end = found.clock.inverse(seconds[0].time[[0, -1]])
        if not (begin < first.time[-1] and end > first.time[0]):
            raise InputError(
                f"{seconds[0].source}: was recorded at another time than "
                f"{first.source} by the calibration's clocks; leave --calibration out"
            )
        alignments.append(found)
    if any(len(recording.takes) > 1 for recording in recordings):
        return _identify(recordings, chosen, alignments)
    takes, scores = zip(*(one for (one,) in people), strict=True)
    return Person(list(takes), list(scores), alignments, ())


def _score_people(recording: Recording) -> list[tuple[Take, Array]]:
    """Return the people seen most, who tell where a sensor is, with reliability."""

    def seen(take: Take) -> int:
        return int((take.state > State.NOT_TRACKED).any(axis=1).sum())

    takes = sorted(recording.takes, key=seen, reverse=True)
    found, refused = [], []
    for take in takes[:_TRIED]:
        try:
            found.append(_score(take))
        except InputError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    return found


def _score(take: Take) -> tuple[Take, Array]:
    """Return a take with gross failures repaired, and its reliability (T, J)."""
    take = checked_take(take)
    take = take.at(distinct_stamps(take.time))
    found = Cleaner(CleanConfig(tilt=0.0)).until("reliability").whole(take)
    return found.take(), found.reliability


def _align_people(
    first: Sequence[Take],
    second: Sequence[Take],
    calibration: Sequence[Alignment],
    k: int,
    chosen: Take,
) -> Alignment:
    """Return a sensor's alignment by the two people whose movements are most alike.

    It is the calibration's sensor ``k``, counted without the first.
    """
    found, refused = [], []
    for one, other in product(first, second):
        try:
            alike = align(one, other)
        except InputError as error:
            refused.append(error)
            continue
        explained = alike.explained * len(one)
        explained *= _CHOSEN if one.source == chosen.source else 1.0
        found.append((alike.place_is_sure, explained, alike, other.source))
    if found:
        *_, alike, source = max(found, key=lambda fit: fit[:2])
        return _calibrated(alike, calibration, k, source) if calibration else alike
    if not calibration or len(refused) > 1:
        raise refused[0]
    return calibration[k]


def displacement(before: Placement, after: Placement) -> tuple[float, float] | None:
    """Return how far a sensor was moved [rad, m], None if it seems to stand still."""
    angle = float((after.turn * before.turn.inv()).magnitude())
    shift = float(np.linalg.norm(after.shift - before.shift))
    return (angle, shift) if angle > _TURNED or shift > _SHIFTED else None


def _calibrated(
    found: Alignment, calibration: Sequence[Alignment], k: int, source: str
) -> Alignment:
    """Return an alignment with what the calibration knows better."""
    known = calibration[k]
    away = displacement(known.placed, found.placed)
    if away and found.place_is_sure and found.clock_is_sure:
        places = [one.placed for one in (IDENTITY, *calibration)]
        for (i, one), (j, other) in permutations(enumerate(places, start=1), 2):
            back = one.turn.inv()
            between = Placement(back * other.turn, back.apply(other.shift - one.shift))
            if not displacement(between, found.placed):
                raise InputError(
                    f"{source}: the takes fit the calibration in another order, the "
                    f"first as its sensor {i} and this one as its sensor {j}; give "
                    "them in its order"
                )
        raise InputError(
            f"{source}: its sensor stands {np.degrees(away[0]):.0f} degrees and "
            f"{away[1]:.2f} m away from its place in the calibration, and the takes "
            "fit it in no other order: a sensor was moved; leave --calibration out"
        )
    clock = found.clock if found.clock_is_sure else known.clock
    return found._replace(
        clock=clock, placed=known.placed, certainty=np.inf, path=np.inf
    )


def _identify(
    recordings: Sequence[Recording], chosen: Take, alignments: Sequence[Alignment]
) -> Person:
    """Return one of several people, whom the trackers may have confused."""
    takes, tracks = [], []
    pairs = zip(recordings, (IDENTITY, *alignments), strict=True)
    for s, (recording, found) in enumerate(pairs):
        for take in recording.takes:
            takes.append(take)
            joints = found.placed.apply(take.positions)
            time = found.clock.inverse(take.time)
            tracks.append(Track(time, joints, take.skeleton, s))

    def rows_of_chosen(person: Sequence[Piece]) -> int:
        return sum(len(p.rows) for p in person if takes[p.track] is chosen)

    person = max(people_of(tracks), key=rows_of_chosen)
    own_takes, scores, notes = [], [], []
    own_alignments: list[Alignment] = []
    for s, recording in enumerate(recordings):
        own = [piece for piece in person if piece.sensor == s]
        if sum(len(piece.rows) for piece in own) < 2:
            source = recording.takes[0].source.partition(", body ")[0]
            notes.append(f"{source}: does not show this person, and is left out")
            continue
        take, score = _score(_joined_by_time([takes[p.track].at(p.rows) for p in own]))
        own_takes.append(take)
        scores.append(score)
        own_alignments += alignments[s - 1 : s]  # none for the first sensor
        sources = dict.fromkeys(takes[piece.track].source for piece in own)
        if len(sources) > 1:
            told = "are the same person, by place, time and body lengths"
            notes.append(f"parts of {' and '.join(sources)} {told}")
    return Person(own_takes, scores, own_alignments, tuple(notes))


def _joined_by_time(parts: Sequence[Take]) -> Take:
    names = ("time", "positions", "state")
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    order = np.argsort(whole["time"], kind="stable")
    return replace(parts[0], **{name: values[order] for name, values in whole.items()})
