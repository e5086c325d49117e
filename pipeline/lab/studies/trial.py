"""Who teaches the papers' systems, and on whom they are tested."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinefilter.characters import Skeleton, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.evaluate import LEARNED_REPETITIONS, repetition
from kinefilter.pipeline.lab.systems import School, systems_of
from kinefilter.pipeline.pairs import PairedTake

from .study import Options
from .takes import clips_of, first_person, performed_by, recorded_people

_LEARN_EVERY = 4  # one in this many recorded clips teaches: presets draw a part anyway
Errors = dict[str, float]
"""Mean errors [cm] by who was tested."""


@dataclass(frozen=True, eq=False)
class Group:
    """Takes that systems are tested on, and who teaches them."""

    people: str
    """Who they are: ``new`` or ``known`` to the systems."""
    tests: list[PairedTake]
    school: School

    @property
    def skeleton(self) -> Skeleton:
        """The joints of the takes."""
        return self.tests[0].take.skeleton

    @cached_property
    def accuracy(self) -> Accuracy:
        """How far motions of the skeleton are from the truth."""
        return Accuracy(self.skeleton)

    def makers(self, presets: Sequence[str]) -> list[Callable[[Take], Array]]:
        """Return what makes joint positions [m] of takes: presets, and first none."""
        found: list[Callable[[Take], Array]] = [_raw]
        for system in systems_of((), presets):
            found.append(corrects(system.config, self.school.corrector(system)))
        return found

    def error(self, preset: str | None) -> list[Array]:
        """Return a preset's distances of limb joints [m] (Liu eq. 23-25) in each take.

        Relative to the middle of the hips, with the person's own segment lengths.
        """
        make = self.makers([preset] if preset else [])[-1]
        return [self.accuracy.distances(make(p.take), p.truth) for p in self.tests]


def _raw(take: Take) -> Array:
    return take.positions


def corrects(config: CleanConfig, corrector: Corrector) -> Callable[[Take], Array]:
    """Return what makes of a take the joint positions [m] after correction."""
    cleaner = Cleaner(config, corrector=corrector).until("correct")
    return lambda take: cleaner.whole(take).positions


def simulated(
    options: Options,
    motions: Sequence[str],
    *,
    learners: int,
    share: int = 4,
    sensor: str = "v2",
) -> list[Group]:
    """Return people who perform motions, one group new to the systems and one known.

    The known perform the motions again. Of each group there is one for every ``share``
    learners. The papers say nothing of people who were held back.
    """
    first, new = (first_person(options.seed, learners=who) for who in (True, False))
    testers, progress = max(learners // share, 1), options.progress

    def record(who: range, *, again: bool = False) -> list[PairedTake]:
        return performed_by(who, motions, sensor=sensor, again=again, progress=progress)

    school = school_of(record(range(first, first + learners)), options)
    strangers = record(range(new, new + testers))
    known = record(range(first, first + testers), again=True)
    return [Group("new", strangers, school), Group("known", known, school)]


def recorded(options: Options, *, every: int, count: int = 1000) -> Iterator[Group]:
    """Yield recorded people, each left out in turn, then new repetitions of all.

    Their names are those of the simulated groups, after ``recorded``. Without
    recordings there are none.

    Args:
        options: Where the recordings are.
        every: One in this many clips is tested.
        count: People at most.
    """
    people = recorded_people(options.data)[:count] if options.data else []
    left_out = people if len(people) > 1 else []
    for person in [*left_out, None] if people else []:
        train, test = split(people, person, options)
        who = "new" if person else "known"
        yield Group(f"recorded, {who}", test[::every], school_of(train, options))


def split(
    people: Sequence[str], person: str | None, options: Options
) -> tuple[list[PairedTake], list[PairedTake]]:
    """Return clips that teach, every fourth of them, and clips to test on.

    Those of the others and of one person; for nobody, of all people the repetitions 1
    to 7 and 8 to 10.
    """
    clips = clips_of(people, 10, options)

    def tested(pair: PairedTake) -> bool:
        if person is None:
            return repetition(pair) > LEARNED_REPETITIONS
        return pair.subject == person

    test = [clip for clip in clips if tested(clip)]
    return [clip for clip in clips if not tested(clip)][::_LEARN_EVERY], test


def school_of(lessons: list[PairedTake], options: Options) -> School:
    """Return what teaches systems by clips, with the built-in database."""
    skeleton = lessons[0].take.skeleton
    return School(
        lessons,
        skeleton,
        people=False,
        database=builtin_database(skeleton),
        progress=options.progress,
    )


def errors(groups: Sequence[Group], preset: str | None) -> Errors:
    """Return a preset's mean error [cm] by who was tested; None: that of the takes."""
    found: dict[str, list[Array]] = {}
    for group in groups:
        found.setdefault(group.people, []).extend(group.error(preset))
    return {people: mean_cm(*parts) for people, parts in found.items()}


def mean_cm(*parts: Array) -> float:
    """Return the mean of distances [m] that are known [cm]."""
    return float(100.0 * np.nanmean(np.concatenate(parts)))
