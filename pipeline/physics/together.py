"""Several people of one recording, pulled through their motions in one world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.gaps import LONG_GAP
from kinefilter.characters.motion import positions_from_rotations
from kinefilter.characters.rotations import continuous, slerp

from .filter import SETTLING, PhysicsResult, PhysicsTrace, SceneProps, accelerations_of
from .pulled_character import PulledCharacter, check_target

_UNSEEN = 0.2  # s between two frames of a person who is then out of view. A guess.


@dataclass(frozen=True, eq=False)
class Performance:
    """A person's targets, as for ``PhysicsFilter.run``, at their own time stamps."""

    time: Array
    positions: Array
    rotations: Array
    stands: Flags
    seen: Flags


class _Cue:
    """What one person does at the time stamps of everyone."""

    def __init__(self, person: Performance, stamps: Array) -> None:
        check_target(person.positions, person.rotations)
        own = person.time
        self._person = person
        self._accelerations = accelerations_of(own, person.positions)
        last, stop = len(own) - 1, np.searchsorted(own, stamps)
        self.after = np.minimum(stop, last)  # the next own frame, or the last
        self._before = np.maximum(self.after - 1, 0)
        gap = own[self.after] - own[self._before]
        inside = (stamps >= own[0]) & (stamps <= own[-1])
        self.is_own = inside & (own[self.after] == stamps)
        away = inside & ~self.is_own
        self.solid = self.is_own | (away & (gap <= _UNSEEN))
        # Whoever is away for long waits where they will appear.
        held = ~inside | (gap > LONG_GAP) | self.is_own | (gap <= 0.0)
        share = (stamps - own[self._before]) / np.where(gap > 0.0, gap, 1.0)
        self._share = np.where(held, 1.0, share)
        self.appears = np.zeros(len(stamps), dtype=bool)
        self.appears[1:] = (np.diff(self.after) != 0) & (gap[1:] > LONG_GAP)

    def target(self, k: int) -> tuple[Array, Array]:
        """Return positions (J, 3) and rotations (J, 4) at a time stamp."""
        person, share = self._person, self._share[k]
        one, two = self._before[k], self.after[k]
        if share == 1.0:
            return person.positions[two], person.rotations[two]
        ends = person.positions[one], person.positions[two]
        turns = slerp(person.rotations[one], person.rotations[two], share)
        return ends[0] + share * (ends[1] - ends[0]), turns

    def acceleration(self, k: int) -> Array:
        """Return the acceleration of the target [m/s^2], (J, 3)."""
        found = self._accelerations[self.after[k]]
        return found if self.is_own[k] else np.zeros_like(found)

    def stands(self, k: int) -> Flags:
        """Return which feet bear weight."""
        return np.asarray(self._person.stands[self.after[k]])

    def seen(self, k: int) -> Flags:
        """Return which hands the sensor saw."""
        return np.asarray(self._person.seen[self.after[k]])


def stamps_of(people: Sequence[Performance]) -> Array:
    """Return all time stamps at which anyone was seen [s]."""
    return np.unique(np.concatenate([person.time for person in people]))


def run_together(
    characters: Sequence[PulledCharacter],
    people: Sequence[Performance],
    frames: Iterable[int] | None = None,
) -> list[PhysicsResult]:
    """Pull all characters of a world through their motions, at the same time.

    A person who is out of view stands on the floor but touches nobody and nothing else.
    Results have each person's own time stamps. ``frames`` yields the index of each of
    ``stamps_of``, for example for a progress bar.
    """
    stamps, world = stamps_of(people), characters[0].world
    cues = [_Cue(person, stamps) for person in people]
    roots = [character.root_body for character in characters]
    things = [
        SceneProps(world.model, world.data, roots, len(person.time))
        for person in people
    ]
    traces = [_trace(len(person.time)) for person in people]
    turns = [np.empty_like(person.rotations) for person in people]
    places = [np.empty((len(person.time), 3)) for person in people]
    for k in range(len(stamps)) if frames is None else frames:
        dt = float(stamps[k] - stamps[k - 1])
        everyone = k == 0 or dt > LONG_GAP
        for character, cue in zip(characters, cues, strict=True):
            character.solid = bool(cue.solid[k])
            if everyone or cue.appears[k]:
                character.start(*cue.target(k), reset_props=k == 0)
        for settling in range(SETTLING if everyone else 1):
            step = 1 / 30 if everyone else dt
            moves = [
                character.plan(
                    *cue.target(k),
                    step,
                    acceleration=None if everyone else cue.acceleration(k),
                    seen=cue.seen(k),
                )
                for character, cue in zip(characters, cues, strict=True)
            ]
            good = world.follow(moves, [cue.stands(k) for cue in cues])
            del settling
        bodies = world.model.geom_bodyid[world.data.contact.geom]
        for n, (character, cue) in enumerate(zip(characters, cues, strict=True)):
            if not cue.is_own[k]:
                continue
            own, trace = cue.after[k], traces[n]
            trace.reset[own] = not everyone and not good[n]
            trace.external_force[own] = character.external_force
            touched = (character.joint_of[bodies] >= 0).any(axis=1)
            trace.contacts[own] = touched.sum()
            turns[n][own], places[n][own] = character.rotations, character.root
            things[n].record(own)
    results = []
    for n, (character, person) in enumerate(zip(characters, people, strict=True)):
        joints = positions_from_rotations(turns[n], places[n], character.body)
        away = np.linalg.norm(joints - person.positions, axis=-1)
        traces[n].tracking_error[:] = away.mean(axis=-1)
        results.append(
            PhysicsResult(continuous(turns[n]), joints, traces[n], things[n])
        )
    return results


def _trace(count: int) -> PhysicsTrace:
    types = (float, float, np.int64, np.bool_)
    return PhysicsTrace(*(np.zeros(count, dtype) for dtype in types))
