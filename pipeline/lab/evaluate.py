"""How near every method comes to marker mocap, on people or repetitions unseen."""

from __future__ import annotations

import multiprocessing
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from rich.table import Column, Table

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array, check_kind, check_word
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.failures import FailureKind
from kinefilter.pipeline.methods import SCORERS, load
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .accuracy import FAR, Accuracy, Tally, area_under_roc
from .bench import Timed
from .database_build import database_from_pairs
from .systems import School, System, as_step, systems_of

_WITHOUT_PARTS = {
    "local-gp": (
        *("local-gp:temporal=0:reliability=0", "local-gp:reliability=0"),
        "local-gp:temporal=0",
    ),
    "local-pca": ("nearest", "no-reliability"),
}
_WORTH_PROCESSES = 100  # clips to clean, for which processes are started
Protocol = Literal["people", "movements", "repetitions"]
LEARNED_REPETITIONS = 7
"""Repetitions e01 to e07 teach, e08 to e10 test."""


@dataclass(frozen=True)
class _Fold:
    """Clips to learn from and clips to test on."""

    train: list[PairedTake]
    test: list[PairedTake]


def evaluate(
    train: Sequence[PairedTake],
    test: Sequence[PairedTake],
    methods: Sequence[str],
    *,
    protocol: Protocol = "people",
    presets: Sequence[str] = (),
    assigned: Sequence[str] = (),
    physics: bool = True,
    ablation: bool = False,
    database: PostureDatabase | Literal["mocap"] | None = None,
    every: int = 1,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Return the accuracy of methods, in cm, and their speed.

    Each method takes the place of the correction stage; what is measured is the clip
    that ``clean`` then makes. ``none`` is the clip without any correction.

    Args:
        train: Clips to learn from.
        test: Clips to test on; none: one person of ``train`` after the other.
        methods: Names out of ``METHODS``; ``systems_of`` says how to join them and to
            set their parameters.
        protocol: ``people`` tests on people that were not learned from; ``movements``
            on people and movements of which neither was learned from;
            ``repetitions`` learns from the repetitions e01 to e07 of all the clips
            given and tests on the others.
        presets: Names out of ``PRESETS``, likewise.
        assigned: Parameters of all of them, NAME=VALUE.
        physics: Pull the simulated character through the motions, as ``clean`` does.
        ablation: Measure also what a part of a method is worth: ``local-gp`` without
            terms of its energy (Liu 2016, Table 5), and ``local-pca`` as Shum's
            methods A and B, ``nearest`` and ``no-reliability``.
        database: Natural postures for methods that need some, but for ``default``;
            ``mocap``: those of the clips to learn from; by default the built-in ones.
        every: Test on every Nth clip only.
        progress: Wraps the loops, for a progress bar.

    Raises:
        InputError: An unknown method, too few people or repetitions.
    """
    for asked, what in ((methods, "methods"), (presets, "presets")):
        check_kind(asked, list | tuple, what)
        for name in asked:
            check_kind(name, str, f"one of the {what}")
    for pairs, what in ((train, "train"), (test, "test")):
        check_kind(pairs, list | tuple, what)
        for pair in pairs:
            check_kind(pair, PairedTake, f"one of {what}")
    check_word(protocol, get_args(Protocol), "protocol")
    if not isinstance(database, PostureDatabase | None):
        check_word(database, ("mocap",), "database")
    parts = [p for m in methods for p in _WITHOUT_PARTS.get(m, ()) if ablation]
    methods = [*methods, *(part for part in parts if part not in methods)]
    systems = systems_of(methods, presets, assigned, physics=physics)
    folds = [
        _Fold(fold.train, fold.test[:: as_step(every)])
        for fold in _folds(train, test, protocol)
    ]
    accuracy = Accuracy(folds[0].test[0].take.skeleton)
    tallies: dict[str, Tally] = {"raw": Tally(accuracy)}
    for fold in folds:
        school = _school(fold, database, progress)
        taught = [(system, school.corrector(system)) for system in systems]
        for pair in fold.test:
            tallies["raw"].add(pair, pair.take.positions, 0.0)
        for name, found in _tested(fold.test, taught, progress).items():
            tallies.setdefault(name, Tally(accuracy)).extend(found)
    tested = [pair for fold in folds for pair in fold.test]
    return {
        "protocol": protocol,
        "physics": physics,
        "test_clips": len(tested),
        "reliability_auc": reliability_auc(tested),
        "methods": {name: tally.summary() for name, tally in tallies.items()},
        "worse_than_none": _worse_than_none(tallies),
    }


def _worse_than_none(tallies: dict[str, Tally]) -> dict[str, tuple[int, int]]:
    """Return in how many movements of a person E_var grew by 1 %, and of how many."""
    if "none" not in tallies:
        return {}
    smoothed = tallies["none"].by_movement()
    counts = {}
    for name, tally in tallies.items():
        cells = tally.by_movement()
        worse = sum(cells[key] > 1.01 * least for key, least in smoothed.items())
        counts[name] = (worse, len(smoothed))
    return {name: counts[name] for name in counts if name not in ("raw", "none")}


def _tested(
    pairs: Sequence[PairedTake],
    taught: Sequence[tuple[System, Corrector]],
    progress: Progress,
) -> dict[str, Tally]:
    """Return what each method does on clips; many clips go to all cores."""
    alone = multiprocessing.parent_process() is None
    if not alone or len(pairs) * len(taught) < _WORTH_PROCESSES:
        return {s.label: tallied(pairs, c, s.config, progress) for s, c in taught}
    with workers() as pool:
        jobs = [
            (system.label, pool.submit(tallied, pairs, corrector, system.config))
            for system, corrector in taught
        ]
        return {name: result.result() for name, result in over(jobs, "test", progress)}


def tallied(
    pairs: Sequence[PairedTake],
    corrector: Corrector,
    config: CleanConfig,
    progress: Progress = silent,
) -> Tally:
    """Clean takes by a method and tally the clips beside the truth."""
    tally = Tally(Accuracy(pairs[0].take.skeleton))
    correct = Timed(Correct(config, corrector))
    cleaner = Cleaner(config).replaced(correct)
    for pair in over(pairs, "test", progress):
        corrector.know(pair.subject)
        result = cleaner.clean(pair.take)
        clip = result.clip
        # A clip is level; take and truth are in the sensor's frame.
        turn = clip.tilt, clip.roll
        take = replace(pair.take, positions=leveled(pair.take.positions, *turn))
        level = replace(pair, take=take, truth=leveled(pair.truth, *turn))
        told = any(f.kind == FailureKind.DISPLACED for f in result.failures)
        seconds, sure = correct.seconds[-1], clip.uncertainty
        tally.add(level, clip.positions, seconds, sure, told=told)
    return tally


def _school(
    fold: _Fold,
    database: PostureDatabase | Literal["mocap"] | None,
    progress: Progress,
) -> School:
    """Return what teaches by the clips of a fold."""
    skeleton = fold.test[0].take.skeleton
    people = {pair.subject for pair in fold.train}
    return School(
        fold.train,
        skeleton,
        people=any(pair.subject in people for pair in fold.test),
        database=_postures(fold, skeleton, database, progress),
        progress=progress,
    )


def _postures(
    fold: _Fold,
    skeleton: Skeleton,
    database: PostureDatabase | Literal["mocap"] | None,
    progress: Progress,
) -> PostureDatabase:
    if database is None:
        return builtin_database(skeleton)
    if isinstance(database, str):
        return database_from_pairs(over(fold.train, "mocap", progress), skeleton)
    return database


def _folds(
    train: Sequence[PairedTake], test: Sequence[PairedTake], protocol: str
) -> Iterator[_Fold]:
    pairs = [*train, *test]
    if protocol == "repetitions":
        early = [p for p in pairs if repetition(p) <= LEARNED_REPETITIONS]
        late = [p for p in pairs if repetition(p) > LEARNED_REPETITIONS]
        if not early or not late:
            raise InputError(
                "protocol repetitions needs clips e01 to e07 to learn from and e08 on "
                f"to test on; given are {len(early)} and {len(late)}"
            )
        yield _Fold(early, late)
    elif test and protocol == "people":
        yield _Fold(list(train), list(test))
    else:
        people = sorted({pair.subject for pair in train})
        if len(people) < 2:
            raise InputError(
                f"protocol {protocol} leaves one person out, and needs two or more; "
                "give more pairs files, or --test"
            )
        for person in people:
            others = [p for p in train if p.subject != person]
            own = [p for p in train if p.subject == person]
            if protocol == "people":
                yield _Fold(others, own)
                continue
            for movement in sorted({p.movement for p in own}):
                yield _Fold(
                    [p for p in others if p.movement != movement],
                    [p for p in own if p.movement == movement],
                )


def repetition(pair: PairedTake) -> int:
    """Return the repetition that a clip's name tells, as in m01_s02_e05."""
    found = re.search(r"_e(\d+)", pair.clip)
    if found is None:
        raise InputError(
            f"{pair.take.source}: the clip's name tells no repetition; expected one "
            "such as m01_s02_e05, or use --protocol people"
        )
    return int(found.group(1))


def reliability_auc(
    pairs: Sequence[PairedTake],
) -> dict[str, dict[str, float | None]]:
    """Return how well each scoring finds limb joints that are far off.

    Area under the ROC curve of 1 - reliability, for joints over 10 cm off, and for
    joints over 7 cm off without their constant offset; None where there are none.
    """
    far: dict[str, list[NDArray[np.bool_]]] = {
        "over_10_cm": [],
        "varying_over_7_cm": [],
    }
    doubt: dict[str, list[Array]] = {name: [] for name in SCORERS}
    for pair in pairs:
        accuracy = Accuracy(pair.take.skeleton)
        positions, truth = pair.take.positions, pair.truth
        distances = accuracy.distances(positions, truth).ravel()
        seen = ~np.isnan(distances)
        far["over_10_cm"].append(distances[seen] > 0.10)
        varying = accuracy.varying(positions, truth).ravel()
        far["varying_over_7_cm"].append(varying[seen] > FAR)
        reference = measure_reference(pair.take)
        for name in SCORERS:
            scorer = load(SCORERS[name])(pair.take.skeleton, reference)
            reliability = scorer.score(pair.take).reliability
            doubt[name].append(1.0 - reliability[:, accuracy.limbs].ravel()[seen])
    areas: dict[str, dict[str, float | None]] = {}
    for name, scores in doubt.items():
        areas[name] = {}
        for key, labels in far.items():
            wrong, score = np.concatenate(labels), np.concatenate(scores)
            areas[name][key] = area_under_roc(wrong, score)
    return areas


def as_table(figures: dict[str, Any]) -> Table:
    """Return the figures for a terminal."""
    title = (
        f"{figures['test_clips']} clips, protocol {figures['protocol']}"
        f"{', after physics' if figures['physics'] else ''}; cm, and against raw"
    )
    table = Table(
        Column("method", no_wrap=True),
        "E",
        "E_std",
        "E_var",
        "p95",
        "jitter",
        "ms",
        "within",
        "found",
        title=title,
    )
    raw = figures["methods"]["raw"]
    for name, row in figures["methods"].items():
        table.add_row(
            name,
            *(
                f"{row[key]:.2f} {row[key] / raw[key] - 1:+4.0%}"
                for key in ("E", "E_std", "E_var")
            ),
            f"{row['p95']:.1f}",
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
        f"of {last['clips_off']} clips with a limb 12 cm off for half a second, offset "
        f"removed, {last['clips_off_told']} are told by the last method, and "
        f"{last['false_alarms']} of the {figures['test_clips'] - last['clips_off']} "
        "others; "
        "within: % of coordinates off by less than their uncertainty, and than 1.96 "
        "times as much; area under ROC of joints over 7 cm off, offset removed: found, "
        f"by how far they were moved; by reliability: {areas}"
    )
    if cells := figures["worse_than_none"]:
        told = [f"{name} {worse} of {count}" for name, (worse, count) in cells.items()]
        table.caption += (
            "; people's movements whose E_var is over 1 % above that of none: "
            f"{', '.join(told)}"
        )
    return table


def _numbers(digits: str, *values: float | None) -> str:
    return ", ".join(format(value, digits) for value in values if value is not None)
