"""Accuracy of methods against marker mocap, on unseen people or repetitions."""

import multiprocessing
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from rich.table import Column, Table

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array, Flags, check_choice, check_kind
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.failures import FailureKind
from kinefilter.pipeline.formats.plain import counted
from kinefilter.pipeline.live.crowd import MEASURED_FOR
from kinefilter.pipeline.methods import SCORERS, load
from kinefilter.pipeline.pairs import PairedTake, one_skeleton
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .accuracy import FAR, Accuracy, Tally, area_under_roc
from .bench import Timed
from .database_build import database_from_pairs
from .methods.training_data import TrainingSet
from .systems import CorrectorFactory, System, as_step, systems_of

_FEWEST_FOR_PROCESSES = 100  # cleaned clips from which starting processes pays off
Protocol = Literal["people", "movements", "repetitions"]
LEARNED_REPETITIONS = 7  # protocol repetitions tests on those after e07
_Fold = tuple[list[PairedTake], list[PairedTake]]  # for training and for testing


def evaluate(
    train: Sequence[PairedTake],
    test: Sequence[PairedTake],
    methods: Sequence[str | Corrector],
    *,
    protocol: Protocol = "people",
    presets: Sequence[str] = (),
    assigned: Sequence[str] = (),
    physics: bool = True,
    database: PostureDatabase | Literal["mocap"] | None = None,
    views: TrainingSet | None = None,
    live: bool = False,
    every: int = 1,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Return the errors of methods, in cm, and their speed.

    ``kinefilter evaluate --help`` explains the figures, and the arguments as options;
    clips, from ``read_pairs``, are in place of files, and ``assigned`` is ``--set``.
    ``methods`` may also contain correctors of your own, named after their class.
    ``database`` is by default the built-in one, and with ``mocap`` made of the training
    clips; ``views`` are sessions of two sensors, from which ``learned`` learns as well,
    as the default has. Raises an InputError if a method is unknown, if people or
    repetitions are too few, or if skeletons differ.

    Besides ``protocol``, ``physics``, ``live`` and the number of ``test_clips``, the
    result has, as floats or None where unknown:

    - ``methods``: for each, and for raw, ``E``, ``E_std``, ``E_var`` and ``p95`` [cm];
      ``hips`` [cm/s]; ``jitter`` [m/s³]; ``within_68`` and ``within_95``, the two
      shares of within [%]; ``found``; ``ms_per_frame``; ``joints``, E of each [cm];
      ``people``, these figures of each; ``movements``, E_var [cm] of each person in
      each; and counts of clips: ``clips_off``, where a limb is 12 cm off for half a
      second, ``clips_off_told``, of which the method warns, and ``false_alarms``, the
      other clips of which it warns
    - ``reliability_auc``: of each scoring, how well it detects joints ``over_10_cm``
      off, and ``varying_over_7_cm`` about their constant offset (area under the ROC
      curve)
    - ``worse_than_none``: of each method, the number of movements by a person with an
      E_var over 1 % above that of none, and the number of all
    """
    for items, kind, what in (
        (methods, str | Corrector, "methods"),
        (presets, str, "presets"),
        (train, PairedTake, "train"),
        (test, PairedTake, "test"),
    ):
        check_kind(items, list | tuple, what)
        for item in items:
            check_kind(item, kind, f"an item of {what}")
    check_choice(protocol, get_args(Protocol), "protocol")
    if not isinstance(database, PostureDatabase | None):
        check_choice(database, ("mocap",), "database")
    named = [method for method in methods if isinstance(method, str)]
    systems = systems_of(named, presets, assigned, physics=physics)
    own = _own_systems(methods, physics)
    step = as_step(every)
    folds = [(known, new[::step]) for known, new in folds_of(train, test, protocol)]
    tested = [pair for _, new in folds for pair in new]
    skeleton = one_skeleton([*train, *test])
    accuracy = Accuracy(skeleton)
    tallies: dict[str, Tally] = {"raw": Tally(accuracy)}
    for known, new in folds:
        postures = database
        if isinstance(postures, str):
            postures = database_from_pairs(over(known, "mocap", progress), skeleton)
        met = {pair.subject for pair in known} & {pair.subject for pair in new}
        school = CorrectorFactory(
            known,
            skeleton,
            people=bool(met),
            views=views,
            database=postures,
            progress=progress,
        )
        trained = [(system, school.corrector(system)) for system in systems]
        trained += own
        for pair in new:
            tallies["raw"].add(pair, pair.take.positions, 0.0)
        for name, tally in _test(new, trained, live, progress).items():
            tallies.setdefault(name, Tally(accuracy)).extend(tally)
    return {
        "protocol": protocol,
        "physics": physics,
        "live": live,
        "test_clips": len(tested),
        "reliability_auc": reliability_auc(tested),
        "methods": {name: tally.summary() for name, tally in tallies.items()},
        "worse_than_none": _worse_than_none(tallies),
    }


def _own_systems(
    methods: Sequence[str | Corrector], physics: bool
) -> list[tuple[System, Corrector]]:
    """Return the correctors among methods, with a label for each."""
    correctors = [method for method in methods if isinstance(method, Corrector)]
    names = [type(corrector).__name__ for corrector in correctors]
    labels = [
        name if names.count(name) == 1 else f"{name} {names[: k + 1].count(name)}"
        for k, name in enumerate(names)
    ]
    config = CleanConfig(physics=physics)
    systems = [System(label, config, ()) for label in labels]
    return [*zip(systems, correctors, strict=True)]


def _worse_than_none(tallies: dict[str, Tally]) -> dict[str, tuple[int, int]]:
    """Count the movements with an E_var over 1 % above that of ``none``, and all."""
    if "none" not in tallies:
        return {}
    errors = {name: tally.by_movement() for name, tally in tallies.items()}
    counts = {}
    for name, own in errors.items():
        if name not in ("raw", "none"):
            worse = [
                own[movement][person] > 1.01 * error
                for movement, people in errors["none"].items()
                for person, error in people.items()
            ]
            counts[name] = (sum(worse), len(worse))
    return counts


def _test(
    pairs: Sequence[PairedTake],
    trained: Sequence[tuple[System, Corrector]],
    live: bool,
    progress: Progress,
) -> dict[str, Tally]:
    """Return the results of each system; many clips are shared among all cores."""
    jobs = {s.label: (pairs, corrector, s.config, live) for s, corrector in trained}
    is_worker = multiprocessing.parent_process() is not None
    own = any(not system.methods for system, _ in trained)  # may not pickle
    if is_worker or own or len(pairs) * len(trained) < _FEWEST_FOR_PROCESSES:
        return {label: tally_clips(*job, progress) for label, job in jobs.items()}
    with workers() as pool:
        results = {name: pool.submit(tally_clips, *job) for name, job in jobs.items()}
        shown = over(list(results), "test", progress)
        return {name: results[name].result() for name in shown}


def tally_clips(
    pairs: Sequence[PairedTake],
    corrector: Corrector,
    config: CleanConfig,
    live: bool = False,
    progress: Progress = silent,
) -> Tally:
    """Clean takes with a corrector and compare the clips with the ground truth."""
    tally = Tally(Accuracy(pairs[0].take.skeleton))
    correct = Timed(Correct(config, corrector))
    cleaner = Cleaner(config).replaced(correct)
    for pair in over(pairs, "test", progress):
        corrector.select_person(pair.subject)
        if live:
            first = pair.take.time <= pair.take.time[0] + MEASURED_FOR
            poses = followed(cleaner, pair.take, pair.take.at(first))
            tally.add(pair, poses, sum(correct.seconds[-len(poses) :]))
            continue
        result = cleaner.clean(pair.take)
        clip = result.clip
        # The clip is leveled; take and truth are in the sensor frame.
        turn = clip.tilt, clip.roll
        take = replace(pair.take, positions=leveled(pair.take.positions, *turn))
        level = replace(pair, take=take, truth=leveled(pair.truth, *turn))
        warned = any(f.kind == FailureKind.DISPLACED for f in result.failures)
        seconds = correct.seconds[-1]
        tally.add(level, clip.positions, seconds, clip.uncertainty, warned=warned)
    return tally


def followed(cleaner: Cleaner, take: Take, first: Take) -> Array:
    """Return the poses [m] (T, J, 3) of a live character, a person measured in a take.

    ``first`` are the frames in which ``live`` measures the person.
    """
    cleaner.start(*cleaner.measure(first))
    frames = zip(take.positions, take.time.tolist(), take.state, strict=True)
    return np.array([cleaner.step(*frame).positions for frame in frames])


def folds_of(
    train: Sequence[PairedTake], test: Sequence[PairedTake], protocol: Protocol
) -> Iterator[_Fold]:
    """Yield clips for training and for testing, as ``evaluate`` explains."""
    if protocol == "repetitions":
        pairs = [*train, *test]
        early = [p for p in pairs if repetition(p) <= LEARNED_REPETITIONS]
        late = [p for p in pairs if repetition(p) > LEARNED_REPETITIONS]
        if not early or not late:
            raise InputError(
                "protocol repetitions trains on e01 to e07 and tests on e08 and later, "
                f"but the pairs contain {len(early)} and {len(late)} such clips; give "
                "more pairs files, or use --protocol people"
            )
        yield early, late
        return
    if test and protocol == "people":
        yield list(train), list(test)
        return
    people = sorted({pair.subject for pair in train})
    if len(people) < 2:
        raise InputError(
            f"protocol {protocol} leaves one person out at a time and needs two or "
            f"more, found {len(people)}; give more pairs files, or --test"
        )
    for person in people:
        others = [p for p in train if p.subject != person]
        own = [p for p in train if p.subject == person]
        if protocol == "people":
            yield others, own
            continue
        for movement in sorted({p.movement for p in own}):
            yield (
                [p for p in others if p.movement != movement],
                [p for p in own if p.movement == movement],
            )


def repetition(pair: PairedTake) -> int:
    """Return the number of the repetition in a clip's name, such as m01_s02_e05."""
    number = re.search(r"_e(\d+)", pair.clip)
    if number is None:
        raise InputError(
            f"{pair.take.source}: the clip name {pair.clip!r} contains no repetition; "
            "expected a name such as m01_s02_e05, or use --protocol people"
        )
    return int(number.group(1))


def reliability_auc(pairs: Sequence[PairedTake]) -> dict[str, dict[str, float | None]]:
    """Return how well each scoring finds limb joints with large errors.

    The figures are areas under the ROC curve of 1 - reliability for joints over 10 cm
    off, and over 7 cm without their constant offset; None if there are none or only
    such joints.
    """
    wrong: dict[str, list[Flags]] = {"over_10_cm": [], "varying_over_7_cm": []}
    doubt: dict[str, list[Array]] = {name: [] for name in SCORERS}
    for pair in pairs:
        accuracy = Accuracy(pair.take.skeleton)
        distances = accuracy.distances(pair.take.positions, pair.truth).ravel()
        varying = accuracy.varying(pair.take.positions, pair.truth).ravel()
        known = ~np.isnan(distances)
        wrong["over_10_cm"].append(distances[known] > 0.10)
        wrong["varying_over_7_cm"].append(varying[known] > FAR)
        reference = measure_reference(pair.take)
        for name in SCORERS:
            scorer = load(SCORERS[name])(pair.take.skeleton, reference)
            reliability = scorer.score(pair.take).reliability
            doubt[name].append(1.0 - reliability[:, accuracy.limbs].ravel()[known])
    return {
        name: {
            key: area_under_roc(np.concatenate(labels), np.concatenate(scores))
            for key, labels in wrong.items()
        }
        for name, scores in doubt.items()
    }


def as_table(figures: dict[str, Any]) -> Table:
    """Return the figures for a terminal."""
    count = figures["test_clips"]
    physics = ", with physics" if figures["physics"] else ""
    physics += ", live" if figures["live"] else ""
    title = (
        f"{counted(count, 'clip')}, protocol {figures['protocol']}{physics}; errors in "
        "cm, and their change from raw"
    )
    headings = ("E", "E_std", "E_var", "hips", "jitter", "ms", "within", "found")
    table = Table(Column("method", no_wrap=True), *headings, title=title)
    raw = figures["methods"]["raw"]
    for name, row in figures["methods"].items():
        errors = (f"{row[k]:.2f} {row[k] / raw[k] - 1:+4.0%}" for k in headings[:3])
        table.add_row(
            name,
            *errors,
            _numbers(".1f", row["hips"]),
            f"{row['jitter']:.0f}",
            f"{row['ms_per_frame']:.2f}",
            _numbers(".0f", row["within_68"], row["within_95"]),
            _numbers(".2f", row["found"]),
        )
    areas = ", ".join(
        f"{name} {value:.2f}"
        for name, scores in figures["reliability_auc"].items()
        if (value := scores["varying_over_7_cm"]) is not None
    )
    last = list(figures["methods"].values())[-1]
    table.caption = (
        "within: % of coordinates with errors below their uncertainty, and below 1.96 "
        "times it; found: area under the ROC curve for joints over 7 cm off without "
        "their constant offset, ranked by how far the method moved them; ranked by "
        f"reliability instead: {areas}; in {last['clips_off']} clips a limb is 12 cm "
        "off for half a second, offset removed"
    )
    if not figures["live"]:
        table.caption += (
            f": the last method warns of {last['clips_off_told']} of them, and of "
            f"{last['false_alarms']} of the other {count - last['clips_off']}"
        )
    if cells := figures["worse_than_none"]:
        worse = [f"{name} {bad} of {every}" for name, (bad, every) in cells.items()]
        table.caption += (
            "; movements of a person with an E_var over 1 % above that of none: "
            f"{', '.join(worse)}"
        )
    return table


def _numbers(digits: str, *values: float | None) -> str:
    return ", ".join(format(value, digits) for value in values if value is not None)
