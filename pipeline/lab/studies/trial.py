"""The papers' systems on trial: training and test data, errors, joints followed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.evaluate import folds_of
from kinefilter.pipeline.lab.systems import CorrectorFactory, systems_of
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.pairs import PairedTake

from .study import Options, Panel, Row, Series, Study
from .study_takes import clips_of, first_person, performed_by, recorded_people

_TRAIN_EVERY = 4  # one in this many recorded clips: presets use a part of them anyway


@dataclass(frozen=True, eq=False)
class Group:
    """Takes that systems are tested on, with the systems' training data."""

    people: str  # whether the people are new to the systems or known
    tests: list[PairedTake]
    trainer: CorrectorFactory

    @cached_property
    def accuracy(self) -> Accuracy:
        """Measures distances of the takes' motions from the truth."""
        return Accuracy(self.tests[0].take.skeleton)

    def runners(self, presets: Sequence[str]) -> list[Callable[[Take], Array]]:
        """Return functions from a take to joints [m]: raw, then the presets'."""
        runners: list[Callable[[Take], Array]] = [lambda take: take.positions]
        for system in systems_of((), presets):
            runners.append(correction(system.config, self.trainer.corrector(system)))
        return runners

    def error(self, preset: str | None) -> list[Array]:
        """Return distances of limb joints [m] (Liu eq. 23-25); None: raw."""
        run = self.runners([preset] if preset else [])[-1]
        return [self.accuracy.distances(run(p.take), p.truth) for p in self.tests]


def correction(config: CleanConfig, corrector: Corrector) -> Callable[[Take], Array]:
    """Return a function from a take to the joint positions [m] after correction."""
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
    """Return simulated people, in a group new to the systems and a known one.

    Known people are in the training data, and perform the motions again for the test.
    Each group has one person per ``share`` learners.
    """
    first, new = (first_person(options.seed, learners=flag) for flag in (True, False))
    testers, progress = max(learners // share, 1), options.progress

    record = partial(performed_by, motions=motions, sensor=sensor, progress=progress)
    learned = record(range(first, first + learners))
    trainer = CorrectorFactory(learned, progress=progress)
    strangers = record(range(new, new + testers))
    known = record(range(first, first + testers), again=True)
    return [Group("new", strangers, trainer), Group("known", known, trainer)]


def recorded(options: Options, *, every: int, count: int = 1000) -> Iterator[Group]:
    """Yield each recorded person, left out of training, then new repetitions of all.

    One in ``every`` clips of at most ``count`` people is tested. The groups are named
    like the simulated ones, with ``recorded`` in front.
    """
    people = recorded_people(options.data)[:count] if options.data else []
    for who, train, test in recorded_folds(people, options):
        trainer = CorrectorFactory(train, progress=options.progress)
        yield Group(f"recorded, {who}", test[::every], trainer)


def recorded_folds(
    people: Sequence[str], options: Options
) -> Iterator[tuple[str, list[PairedTake], list[PairedTake]]]:
    """Yield ``new`` or ``known``, training clips and test clips of recorded people.

    First the clips of each person, with those of the others for training, then
    repetitions 8 to 10 of all, with 1 to 7 for training: every fourth in each case.
    """
    clips = clips_of(people, 10, options)
    if len(people) > 1:
        for train, test in folds_of(clips, (), "people"):
            yield "new", train[::_TRAIN_EVERY], test
    if people:
        for train, test in folds_of(clips, (), "repetitions"):
            yield "known", train[::_TRAIN_EVERY], test


def errors(groups: Sequence[Group], preset: str | None) -> dict[str, float]:
    """Return a preset's mean error [cm] by test group; None: that of raw takes."""
    return {group.people: mean_cm(*group.error(preset)) for group in groups}


def mean_cm(*parts: Array) -> float:
    """Return the mean of distances [m], ignoring NaN, in cm."""
    return float(100.0 * np.nanmean(np.concatenate(parts)))


@dataclass(frozen=True)
class Trace:
    """A joint to follow through a motion."""

    motion: str
    joint: str  # one of LIMBS
    paper: Mapping[str, float | None]  # its mean errors [cm]: kinect's, then presets'


def trace_study(
    options: Options,
    title: str,
    traces: Sequence[Trace],
    *,
    people: int,
    sensor: str,
    standard: bool = False,
) -> Study:
    """Return errors of joints, and plot them through a take of a known person.

    ``people`` are in the training data, and a quarter as many are tested. With
    ``standard``, both motions are brought to standard segment lengths first. Jitter is
    the mean third difference [m/s^3].
    """
    rows, panels = list[Row](), list[Panel]()
    for trace in traces:
        groups = simulated(options, [trace.motion], learners=people, sensor=sensor)
        k, name = LIMBS.index(trace.joint), f"{trace.joint}, {trace.motion}"
        lines = []
        _, *presets = trace.paper
        for n, (system, paper) in enumerate(trace.paper.items()):
            means, jitters = [], []
            for group in groups:
                run, accuracy = group.runners(presets)[n], group.accuracy
                motions = [run(pair.take) for pair in group.tests]
                distances = accuracy.standardized if standard else accuracy.distances
                both = zip(motions, group.tests, strict=True)
                found = [distances(motion, pair.truth)[:, k] for motion, pair in both]
                means.append(mean_cm(*found))
                joint = [motion[:, [accuracy.limbs[k]]] for motion in motions]
                times = [pair.take.time for pair in group.tests]
                jitters.append(float(np.mean([*map(jitter, times, joint)])))
            rows.append((f"{name}, {system}", *means, *jitters, paper))
            line = 100.0 * np.nan_to_num(found[0])
            lines.append(Series(system, times[0].tolist(), line.tolist()))
        panels.append(Panel(f"s, {name}", "error, cm", lines))
    header = (
        *("joint, motion, system", "new_cm", "known_cm", "new_jitter"),
        *("known_jitter", "paper_cm"),
    )
    return Study(title, header, rows, panels, across=len(panels))
