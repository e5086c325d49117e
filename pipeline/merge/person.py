"""Whom several sensors recorded: one person's take of each, and where the sensors are.

Of several people, those who move most alike tell where the sensors are. In the room of
the first sensor it is then found who is who, everybody's tracks at once (``people``):
what one sensor's tracker exchanged, another one settles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinefilter.characters import InputError, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.checks import check_take
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.formats.recording import Recording
from kinefilter.pipeline.people import Part, Track, people_of

from .alignment import HERE, Alignment, align
from .rigid import Placement

_TURNED, _SHIFTED = np.radians(8.0), 0.25
"""Angle, and distance [m], by which a sensor may seem to have moved between two takes
in which people went to and fro. Placements of the same sensor differ by up to 3 degrees
and 0.1 m in two-kinects (p00 to p08)."""
_CHOSEN = 1.4  # by which the person asked for tells more than others. A guess
_TRIED = 4  # people of a recording who may tell where the sensors are


class Person(NamedTuple):
    """What each sensor that sees a person recorded, beginning with the first."""

    takes: list[Take]
    """With gross failures mended."""
    scores: list[Array]
    """Their reliability, (T, J) each."""
    alignments: list[Alignment]
    """Of the second take, the third and so on."""
    notes: tuple[str, ...]
    """What users should know about who is who."""


def find_person(
    recordings: Sequence[Recording],
    body: int | None,
    calibration: Sequence[Alignment],
) -> Person:
    """Return a person of the first recording as all sensors saw them; see ``merge``.

    Raises InputError if there is no such person, or they do not belong together.
    """
    chosen = recordings[0].take(body)
    several = any(len(recording.takes) > 1 for recording in recordings)
    mended = [_mended(recording) for recording in recordings]
    alignments = []
    for k, others in enumerate(mended[1:]):
        known = calibration[k] if calibration else None
        firsts, seconds = ([take for take, _ in some] for some in (mended[0], others))
        found = _aligned(firsts, seconds, known, chosen)
        begin, end = found.clock.undone(others[0][0].time[[0, -1]])
        first = mended[0][0][0]
        if not (begin < first.time[-1] and end > first.time[0]):
            raise InputError(
                f"{others[0][0].source}: is of another time than {first.source} by the "
                "clocks of the calibration; leave --calibration out"
            )
        alignments.append(found)
    if not several:
        takes, scores = zip(*(one for (one,) in mended), strict=True)
        return Person(list(takes), list(scores), alignments, ())
    return _told_apart(recordings, chosen, alignments)


def _mended(recording: Recording) -> list[tuple[Take, Array]]:
    """Return the people seen most, who tell where a sensor is, and reliability."""

    def seen(take: Take) -> int:
        return int((take.state > State.NOT_TRACKED).any(axis=1).sum())

    takes = sorted(recording.takes, key=seen, reverse=True)
    found, refused = [], []
    for take in takes[:_TRIED]:
        try:
            found.append(_scored(take))
        except InputError as error:
            refused.append(error)
    if not found:
        raise refused[0]
    return found


def _scored(take: Take) -> tuple[Take, Array]:
    """Return a take with gross failures mended, and its reliability (T, J)."""
    check_take(take)
    distinct = np.concatenate([[True], np.diff(take.time) > 0])
    found = Cleaner(CleanConfig(tilt=0.0)).until("reliability").whole(take.at(distinct))
    return found.take(), found.reliability


def _aligned(
    firsts: Sequence[Take],
    others: Sequence[Take],
    known: Alignment | None,
    chosen: Take,
) -> Alignment:
    """Return when and where a sensor is, by those who move most alike."""
    found, refused = [], []
    for first in firsts:
        for other in others:
            try:
                alike = align(first, other)
            except InputError as error:
                refused.append(error)
            else:
                explained = alike.common * len(first)
                explained *= _CHOSEN if first.source == chosen.source else 1.0
                found.append((alike.place_is_sure, explained, alike, other.source))
    if found:
        *_, alike, source = max(found, key=lambda one: one[:2])
        return _checked(alike, known, source)
    if known is None or len(firsts) * len(others) > 1:
        raise refused[0]
    return known


def moved(before: Placement, after: Placement) -> tuple[float, float] | None:
    """Return by how much a sensor was moved [rad, m], None where it seems to stand."""
    angle = float((after.turn * before.turn.inv()).magnitude())
    shift = float(np.linalg.norm(after.shift - before.shift))
    return (angle, shift) if angle > _TURNED or shift > _SHIFTED else None


def _checked(found: Alignment, known: Alignment | None, source: str) -> Alignment:
    """Return an alignment, with what a calibration knows better."""
    if known is None:
        return found
    away = moved(known.placed, found.placed)
    if away and found.place_is_sure and found.clock_is_sure:
        raise InputError(
            f"{source}: its sensor stands {np.degrees(away[0]):.0f} degrees and "
            f"{away[1]:.2f} m away from where the calibration has it; it was moved, "
            "so leave --calibration out"
        )
    clock = found.clock if found.clock_is_sure else known.clock
    return found._replace(
        clock=clock, placed=known.placed, likeness=np.inf, path=np.inf
    )


def _told_apart(
    recordings: Sequence[Recording], chosen: Take, alignments: Sequence[Alignment]
) -> Person:
    """Return one of several people, whom sensors may have taken for each other."""
    takes, tracks = [], []
    for s, (recording, found) in enumerate(
        zip(recordings, (HERE, *alignments), strict=True)
    ):
        for take in recording.takes:
            takes.append(take)
            joints = found.placed.apply(take.positions)
            time = found.clock.undone(take.time)
            tracks.append(Track(time, joints, take.skeleton, s))

    def rows_of_chosen(person: Sequence[Part]) -> int:
        return sum(len(p.rows) for p in person if takes[p.track] is chosen)

    person = max(people_of(tracks), key=rows_of_chosen)
    kept, notes = [], []
    for s, recording in enumerate(recordings):
        own = [part for part in person if tracks[part.track].sensor == s]
        if sum(len(part.rows) for part in own) < 2:
            source = recording.takes[0].source.partition(", body ")[0]
            notes.append(f"{source}: does not show this person, and is left out")
            continue
        kept.append((s, _scored(_joined([takes[p.track].at(p.rows) for p in own]))))
        sources = dict.fromkeys(takes[part.track].source for part in own)
        if len(sources) > 1:
            notes.append(
                f"{' and '.join(sources)} are one person in part, by place, time and "
                "body lengths"
            )
    return Person(
        [take for _, (take, _) in kept],
        [score for _, (_, score) in kept],
        [alignments[s - 1] for s, _ in kept if s],
        tuple(notes),
    )


def _joined(parts: Sequence[Take]) -> Take:
    """Return parts of one person's takes as one, in the order of time."""
    whole = [
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("time", "positions", "state")
    ]
    order = np.argsort(whole[0], kind="stable")
    time, positions, state = (values[order] for values in whole)
    return replace(parts[0], time=time, positions=positions, state=state)
