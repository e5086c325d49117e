"""The takes of the studies, recorded and simulated, and the papers' systems on them.

Simulated people in tests are in no training data: the built-in database draws people
from seeds below 10, test takes from 1000 up, and training data from 500 higher.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.lab.accuracy import LIMBS, Accuracy
from kinefilter.pipeline.lab.evaluate import folds_of
from kinefilter.pipeline.lab.methods.training_data import TrainingSet
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.systems import CorrectorFactory, systems_of
from kinefilter.pipeline.lab.training import observed, training_set
from kinefilter.pipeline.lab.view_sessions import find_sessions, view_pairs
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import Progress, over, silent

from .study import Options, Panel, Row, Series, Study

RECORDINGS = Path("../shared/data")  # default folder; not part of kinefilter
_PEOPLE = 1000  # first seed of a study's people; also the distance between studies
_AGAIN = 1_000_000  # added to a person's seed for another performance
_LEARNERS = 500  # added to the seeds of people in the training data

_STAND_INS = 4  # simulated people in place of recorded ones
_MOVEMENTS = ("squat", "side_lunge", "raise_arms")  # theirs, as in rehabilitation
_REPETITIONS = 10  # of each movement, as in the recordings

Setting = tuple[str, str, str]  # one of SCENES, of MOTIONS and of SENSORS


def _settings(listed: str) -> list[Setting]:
    return [(s, m, v) for s, m, v in (one.split("/") for one in listed.split())]


CLASSES: dict[str, list[Setting]] = {
    "a": _settings(
        "basic/cross_arms/v1 basic/cross_arms/v2 basic/turn/v1 basic/turn/v2 "
        "basic/squat/v1 basic/squat/v2 basic/tai_chi/v1 basic/tai_chi/v2 "
        "basic/wave/v1 basic/punch/v2 basic/march/v1 basic/bend/v2"
    ),
    "b": _settings(
        "office/wave/v1 office/talk/v2 office/cross_arms/v1 office/turn/v2 "
        "flip_chart/wave/v1 flip_chart/clasp_and_spread/v2 flip_chart/side_lunge/v1 "
        "flip_chart/side_lunge/v2 box/wave/v1 box/raise_arms/v2 box/turn/v1 box/turn/v2"
    ),
    "c": _settings(
        "box/lift_box/v1 flip_chart/flip_chart/v1 flip_chart/flip_chart/v2 "
        "box/lift_box/v2 basketball/basketball/v1 basketball/basketball/v2 "
        "chair/chair/v1 chair/chair/v2 chair/sit_to_stand/v1 "
        "office/office/v1 office/office/v2 office/office/v2"
    ),
}
"""Classes of movement (Shum 2013, Table IV): (a) self-occluded and unoccluded ones;
(b) those behind a prop that no one touches: a desk, a flip chart, a box (the chair
stands behind the person and hides nothing); (c) those with a prop that hides the
person. With seed 0, all users of the flip chart use it on their right, where it is."""


def first_person(seed: int, *, learners: bool = False) -> int:
    """Return the seed of a study's first test person, or of its first learner."""
    return _PEOPLE * (1 + seed) + (_LEARNERS if learners else 0)


def study_takes(kind: str, options: Options, *, count: int = 12) -> list[PairedTake]:
    """Return takes of a class with their ground truth, each of a different person."""
    settings = CLASSES[kind]
    first = first_person(options.seed) + len(settings) * list(CLASSES).index(kind)
    chosen = [k * len(settings) // count for k in range(min(count, len(settings)))]
    return [
        _recorded(settings[k], first + k, first + k)
        for k in over(chosen, f"record ({kind})", options.progress)
    ]


def performed_by(
    people: Sequence[int],
    motions: Sequence[str],
    *,
    sensor: str = "v2",
    again: bool = False,
    progress: Progress = silent,
) -> list[PairedTake]:
    """Return each person's take of each motion on a bare floor; ``again``: a repeat."""
    acts = [(person, motion) for person in people for motion in motions]
    return [
        _recorded(("basic", motion, sensor), person + _AGAIN * again, person)
        for person, motion in over(acts, "record", progress)
    ]


@lru_cache(maxsize=256)  # studies share takes; each costs 0.4 s and 0.4 MB
def _recorded(setting: Setting, seed: int, person: int) -> PairedTake:
    scene, motion, sensor = setting
    return simulate(scene, motion, sensor=sensor, seed=seed, person=person)


def recordings_folder(data: Path | None) -> Path | None:
    """Return the given folder, or InputError; without, the default one if it exists."""
    if data is None:
        return RECORDINGS if RECORDINGS.is_dir() else None
    if not data.is_dir():
        raise InputError(f"{data}: folder not found; give the folder of the recordings")
    return data


def recorded_takes(data: Path | None) -> list[Path]:
    """Return the files of the recorded takes, sorted; none without recordings."""
    if data is None:
        return []
    folder = data / "takes"
    return sorted([*folder.glob("*/*.csv"), *folder.glob("*/*.csv.gz")])


def recorded_people(data: Path | None) -> list[str]:
    """Return the names of the people recorded with marker mocap, or of stand-ins."""
    if data is None:
        return [f"simulated {k + 1}" for k in range(_STAND_INS)]
    names = sorted(path.stem for path in (data / "ui-prmd").glob("s*.npz"))
    if not names:
        raise InputError(f"{data}: no ui-prmd/s*.npz in this folder of recordings")
    return names


def clips_of(
    people: Iterable[str], movements: int, options: Options
) -> list[PairedTake]:
    """Return the clips of some ``recorded_people`` in their first movements."""
    clips: list[PairedTake] = []
    for name in people:
        if options.data is None:
            clips += _simulated_clips(name, movements, options.seed)
        else:
            own = read_pairs(options.data / "ui-prmd" / f"{name}.npz")
            known = sorted({pair.clip[:3] for pair in own})[:movements]
            clips += [pair for pair in own if pair.clip[:3] in known]
    return clips


def view_lessons(options: Options) -> TrainingSet | None:
    """Return training data of people before two sensors, None without recordings."""
    if options.data is None or not (folder := options.data / "two-kinects").is_dir():
        return None
    return training_set(view_pairs(find_sessions([folder], None)))


def _simulated_clips(name: str, movements: int, seed: int) -> Iterator[PairedTake]:
    k = recorded_people(None).index(name)
    person = first_person(seed) + k
    for n in range(len(_MOVEMENTS[:movements]) * _REPETITIONS):
        m, e = divmod(n, _REPETITIONS)
        pair = simulate("basic", _MOVEMENTS[m], seed=person + 100 * n, person=person)
        clip = f"m{m + 1:02d}_s{k + 1:02d}_e{e + 1:02d}"  # named like recorded clips
        yield replace(pair, subject=name, clip=clip)


def standardized(pair: PairedTake) -> Draft:
    """Return a take on the standard body, with reliability 0 where joints miss."""
    draft = observed(pair)
    missing = np.isnan(draft.standard[..., 0])
    draft.reliability = np.where(missing, 0.0, draft.reliability)
    return draft


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
