"""How near every method comes to marker mocap, on people or repetitions unseen."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rich.table import Column, Table

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import Corrector, WholeTakeCorrector, correct_take
from kinefilter.pipeline.correct.local_gp import LocalGP
from kinefilter.pipeline.correct.methods import FILTERS, FROM_DATABASE, LEARNED
from kinefilter.pipeline.database import PostureDatabase, builtin_database
from kinefilter.pipeline.database.build import database_from_pairs
from kinefilter.pipeline.default import default_corrector
from kinefilter.pipeline.physics import PhysicsFilter
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability import ReliabilityScorer, measure_reference
from kinefilter.pipeline.reliability.scorers import SCORERS
from kinefilter.pipeline.standard import StandardTake, standardize_take
from kinefilter.pipeline.target import make_target
from kinefilter.pipeline.target.person import corrected_body
from kinefilter.pipeline.training import PairedTake, training_set
from kinefilter.retarget import measured_body

from .accuracy import Accuracy
from .tally import Tally

METHODS = (*FILTERS, *FROM_DATABASE, "default", *LEARNED)
"""Every method that can be evaluated; ``default`` is what ``clean`` does by itself."""

_LIU_TERMS = {
    "local-gp S": {"temporal": 0.0, "reliability": 0.0},
    "local-gp S+T": {"reliability": 0.0},
    "local-gp S+R": {"temporal": 0.0},
}
_WITHOUT_PARTS = ("nearest", "no-reliability")
_LEARNED_REPETITIONS = 7  # e01 to e07 teach, e08 to e10 test


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
    protocol: Literal["people", "repetitions"] = "people",
    physics: bool = False,
    ablation: bool = False,
    database: PostureDatabase | Literal["mocap"] | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Return the accuracy of methods, in cm, and their speed.

    Args:
        train: Clips to learn from.
        test: Clips to test on; none: one person of ``train`` after the other.
        methods: Names out of METHODS.
        protocol: ``people`` tests on people that were not learned from;
            ``repetitions`` learns from the repetitions e01 to e07 of all the clips
            given and tests on the others.
        physics: Send what the methods give through the character too.
        ablation: Measure also what a part of a method is worth: ``local-gp`` without
            terms of its energy (Liu 2016, Table 5), and ``local-pca`` as Shum's
            methods A and B, ``nearest`` and ``no-reliability``.
        database: Natural postures; ``mocap``: those of the clips to learn from; by
            default the built-in ones.
        progress: Wraps the loops, for a progress bar.

    Raises:
        InputError: An unknown method, too few people or repetitions.
    """
    unknown = [name for name in methods if name not in METHODS]
    if unknown:
        raise InputError(f"unknown method {unknown[0]!r}; known: {', '.join(METHODS)}")
    if ablation and "local-pca" in methods:
        methods = [*methods, *(m for m in _WITHOUT_PARTS if m not in methods)]
    folds = list(_folds(train, test, protocol))
    skeleton = folds[0].test[0].take.skeleton
    postures = database
    if postures is None:
        postures = builtin_database(skeleton)
    accuracy = Accuracy(skeleton)
    tallies: dict[str, Tally] = {}
    for fold in folds:
        correctors = _correctors(fold, methods, postures, progress)
        if ablation and isinstance(whole := correctors.get("local-gp"), LocalGP):
            for name, terms in _LIU_TERMS.items():
                correctors[name] = whole.with_terms(**terms)
        for name in ("raw", *correctors):
            tallies.setdefault(name, Tally(accuracy))
        for k in progress("test", len(fold.test)):
            _test(fold.test[k], correctors, tallies, physics)
    tested = [pair for fold in folds for pair in fold.test]
    return {
        "protocol": protocol,
        "physics": physics,
        "test_clips": len(tested),
        "reliability_auc": reliability_auc(tested),
        "methods": {name: tally.summary() for name, tally in tallies.items()},
    }


def _correctors(
    fold: _Fold,
    methods: Sequence[str],
    database: PostureDatabase | Literal["mocap"],
    progress: Progress,
) -> dict[str, Corrector | WholeTakeCorrector]:
    """Return the methods, taught by the fold where they learn."""
    skeleton = fold.test[0].take.skeleton
    correctors: dict[str, Corrector | WholeTakeCorrector] = {}
    lessons = None
    for name in methods:
        if name in FILTERS:
            correctors[name] = FILTERS[name](skeleton)
        elif name in FROM_DATABASE or name == "default":
            if isinstance(database, str):
                database = database_from_pairs(
                    over(fold.train, "mocap", progress), skeleton
                )
            make = FROM_DATABASE.get(name, default_corrector)
            correctors[name] = make(database)
        else:
            lessons = lessons or training_set(over(fold.train, "standardize", progress))
            learner = LEARNED[name](skeleton)
            correctors[name] = learner.fit(lessons, progress=progress)
    return correctors


def _folds(
    train: Sequence[PairedTake], test: Sequence[PairedTake], protocol: str
) -> Iterator[_Fold]:
    pairs = [*train, *test]
    if protocol == "repetitions":
        early = [p for p in pairs if _repetition(p) <= _LEARNED_REPETITIONS]
        late = [p for p in pairs if _repetition(p) > _LEARNED_REPETITIONS]
        if not early or not late:
            raise InputError(
                "protocol repetitions needs clips e01 to e07 to learn from and e08 on "
                f"to test on; given are {len(early)} and {len(late)}"
            )
        yield _Fold(early, late)
    elif test:
        yield _Fold(list(train), list(test))
    else:
        people = sorted({pair.subject for pair in train})
        if len(people) < 2:
            raise InputError(
                "protocol people leaves one person out, and needs two or more; give "
                "more pairs files, or --test"
            )
        for person in people:
            yield _Fold(
                [p for p in train if p.subject != person],
                [p for p in train if p.subject == person],
            )


def _repetition(pair: PairedTake) -> int:
    """Return the repetition that a clip's name tells, as in m01_s02_e05."""
    found = re.search(r"_e(\d+)", pair.clip)
    if found is None:
        raise InputError(
            f"{pair.take.source}: the clip's name tells no repetition; expected one "
            "such as m01_s02_e05, or use --protocol people"
        )
    return int(found.group(1))


def _test(
    pair: PairedTake,
    correctors: dict[str, Corrector | WholeTakeCorrector],
    tallies: dict[str, Tally],
    physics: bool,
) -> None:
    take = pair.take
    standard = observed(pair)
    tallies["raw"].add(pair, take.positions, 0.0)
    for name, corrector in correctors.items():
        start = perf_counter()
        corrected = correct_take(standard, corrector, range(len(take)))
        seconds = perf_counter() - start
        positions = corrected.positions
        if physics:
            body = corrected_body(take, corrected)
            # The truth is in the sensor's frame, whatever that is.
            target = make_target(
                take.time, corrected, body, cutoff=CleanConfig.cutoff, tilt=0.0
            )
            positions = (
                PhysicsFilter(body)
                .run(
                    take.time, target.positions, target.rotations, stands=target.stands
                )
                .positions
            )
        tallies[name].add(pair, positions, seconds)


def observed(pair: PairedTake) -> StandardTake:
    """Return a take as the methods see it: scored, on the standard body."""
    take = pair.take
    reference = measure_reference(take)
    body = measured_body(take.skeleton, reference.lengths, reference.directions)
    reliability = ReliabilityScorer(take.skeleton, reference).score(take)
    return standardize_take(take, body, reliability)


def reliability_auc(
    pairs: Sequence[PairedTake],
) -> dict[str, dict[str, float | None]]:
    """Return how well each scoring finds limb joints that are far off.

    Area under the ROC curve of 1 - rate, for joints over 10 cm off, and for joints over
    7 cm off without their constant offset; None where there are none.
    """
    from sklearn.metrics import roc_auc_score

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
        far["varying_over_7_cm"].append(varying[seen] > 0.07)
        reference = measure_reference(pair.take)
        for name, scorer in SCORERS.items():
            rate = scorer(pair.take.skeleton, reference).score(pair.take).rate
            doubt[name].append(1.0 - rate[:, accuracy.limbs].ravel()[seen])
    areas: dict[str, dict[str, float | None]] = {}
    for name, scores in doubt.items():
        areas[name] = {}
        for key, labels in far.items():
            wrong, score = np.concatenate(labels), np.concatenate(scores)
            found = float(roc_auc_score(wrong, score)) if 0 < wrong.mean() < 1 else None
            areas[name][key] = found
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
        )
    areas = ", ".join(
        f"{name} {value:.2f}"
        for name, scores in figures["reliability_auc"].items()
        if (value := scores["varying_over_7_cm"]) is not None
    )
    table.caption = f"area under ROC of joints over 7 cm off, offset removed: {areas}"
    return table
