"""Errors of limbs hidden in recorded takes, beside mocap and simple guesses."""

import re
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from rich.table import Column, Table

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array, check_choice
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.pairs import PairedTake, one_skeleton
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import Mode
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .accuracy import LIMBS, within_uncertainty
from .evaluate import followed
from .limb_guesses import HIDDEN, SIMPLE, Guess, hide, simple_guesses
from .limb_lessons import Lesson, joined, read_lessons, train_prior, with_prior
from .recorded_acts import NamedTake, recordings_in
from .systems import CorrectorFactory, System, as_step, systems_of

Context = Literal["alone", "repetitions"]
By = Literal["movement", "gap", "person"]
Record = dict[str, Any]

_MARGIN = 5  # frames that a clip needs before and after a gap
_PAUSE = 2.0  # s between the repetitions in a take
_WORSE = 1.0  # cm above the better of hold and slerp, from which a clip counts as worse
_TAKES_PER_JOB = 8
_cleaner = cache(Cleaner)


@dataclass(frozen=True)
class HiddenLimbs:
    """What to hide and how to clean takes; see ``kinefilter evaluate --help``."""

    limbs: tuple[str, ...]
    gaps: tuple[str, ...] = ("55%",)
    guess: Guess = "none"
    context: Context = "alone"
    live: bool = False
    physics: bool = True

    def __post_init__(self) -> None:
        for limb in self.limbs:
            check_choice(limb, HIDDEN, "limb")
        for gap in self.gaps:
            _frames(gap, 100, 30.0)


class Case(NamedTuple):
    """A take, and the clips in it that get a gap, with their first frames."""

    take: Take
    hidden: list[tuple[PairedTake, int]]


def measure_hidden(
    pairs: Sequence[PairedTake],
    methods: Sequence[str],
    options: HiddenLimbs,
    *,
    recordings: Sequence[Path] = (),
    presets: Sequence[str] = (),
    assigned: Sequence[str] = (),
    every: int = 1,
    progress: Progress = silent,
) -> tuple[list[Record], int]:
    """Hide limbs in clips and measure the errors after cleaning.

    Methods, presets and ``assigned`` are as for ``systems_of``. Methods that learn are
    trained on the clips of the other people, with nothing hidden, and so is, with
    ``recordings`` in addition, the prior for hidden limbs; by default it is the one
    that ships. Only every Nth take is cleaned.

    Returns a record of each gap, and the number of gaps that were too long for their
    clip. Errors [cm] are means over frames and joints, of the method, of the clip with
    nothing hidden (``seen``) and of the baselines in ``SIMPLE``: relative to that clip
    (``unhidden``) and to the ground truth (``mocap``). ``within`` is
    ``within_uncertainty`` of the hidden coordinates; None in live mode and without
    ground truth. Raises an InputError if a method is unknown, or no gap fits.
    """
    systems = systems_of(methods, presets, assigned, physics=options.physics)
    cases = list(join_cases(pairs, options.context))[:: as_step(every)]
    takes = [pair.take for case in cases for pair, _ in case.hidden]
    spans = [middle(take, gap) for take in takes for gap in options.gaps]
    skipped = spans.count(None)
    if skipped == len(spans):
        raise InputError(
            f"a gap of {', '.join(options.gaps)}, with {_MARGIN} frames before and "
            f"after it, fits into no clip ({skipped} tried); give a shorter --gap"
        )
    with workers() as pool:
        folds = _folds(systems, cases, pairs, recordings, options, pool, progress)
        jobs = (
            (fold[k : k + _TAKES_PER_JOB], trained, options)
            for fold, ready in folds
            for k in range(0, len(fold), _TAKES_PER_JOB)
            for trained in ready
        )
        if len(cases) <= _TAKES_PER_JOB:
            return [record for job in jobs for record in _measure(*job)], skipped
        waiting = [pool.submit(_measure, *job) for job in jobs]
        done = [job.result() for job in over(waiting, "hide and clean", progress)]
    return [record for records in done for record in records], skipped


class _Ready(NamedTuple):
    """A system, with a corrector and a prior if they are not the default ones."""

    system: System
    corrector: Corrector | None = None
    prior: MotionPrior | None = None


def _folds(
    systems: Sequence[System],
    cases: list[Case],
    pairs: Sequence[PairedTake],
    recordings: Sequence[Path],
    options: HiddenLimbs,
    pool: Executor,
    progress: Progress,
) -> Iterator[tuple[list[Case], list[_Ready]]]:
    learning = [system for system in systems if system.learns or recordings]
    yield cases, [_Ready(system) for system in systems if system not in learning]
    if learning:
        one_skeleton(pairs)
    people = sorted({pair.subject for pair in pairs}) if learning else []
    if len(people) == 1:
        raise InputError(
            f"{learning[0].label} learns from other people, but all pairs are of "
            f"{people[0]}; give pairs files of two or more people"
        )
    lessons: list[Lesson] = []
    if recordings:
        read = [one for file in recordings for one in recordings_in(file)]
        read += map(NamedTake.of, pairs)
        mode: Mode = "before" if options.live else "between"
        lessons = read_lessons(over(read, "read", progress), (mode, "unseen"))
    for person in people:
        own = [c for c in cases if c.hidden and c.hidden[0][0].subject == person]
        if not own:
            continue
        rest = [pair for pair in pairs if pair.subject != person]
        school = CorrectorFactory(rest, own[0].take.skeleton, progress=progress)
        others = joined(lesson for lesson in lessons if lesson.person != person)
        prior = train_prior(others, pool) if recordings else None
        correctors = [school.corrector(s) if s.learns else None for s in learning]
        ready = zip(learning, correctors, strict=True)
        yield own, [_Ready(*each, prior) for each in ready]


def _frames(gap: str, count: int, fps: float) -> int:
    percent, number = gap.endswith("%"), gap.removesuffix("%")
    valid = re.fullmatch(r"\d{0,4}\.?\d{1,9}", number)
    if not valid or (percent and float(number) >= 100):
        raise InputError(
            f"gap {gap!r}: expected seconds, such as 0.3, or less than 100 percent of "
            "the clip, such as 55%"
        )
    return round(count * float(number) / 100 if percent else float(number) * fps)


def middle(take: Take, gap: str) -> slice | None:
    """Return the frames of a gap in the middle of a clip, None if it does not fit."""
    count = _frames(gap, len(take), take.fps)
    start = (len(take) - count) // 2
    return slice(start, start + count) if count > 0 and start >= _MARGIN else None


def join_cases(pairs: Sequence[PairedTake], context: Context) -> Iterator[Case]:
    """Yield each clip as a take, or join repetitions and give every third a gap."""
    if context == "alone":
        yield from (Case(pair.take, [(pair, 0)]) for pair in pairs)
        return
    groups: dict[tuple[str, str], list[PairedTake]] = {}
    for pair in sorted(pairs, key=lambda pair: pair.clip):
        name = re.sub(r"_e\d+", "", pair.clip)
        if name == pair.clip:
            raise InputError(
                f"{pair.take.source}: the clip name {pair.clip!r} contains no "
                "repetition; expected a name such as m01_s02_e05, or use --context "
                "alone"
            )
        groups.setdefault((pair.subject, name), []).append(pair)
    for group in groups.values():
        takes, time = [pair.take for pair in group], [-_PAUSE]
        for take in takes:
            time.extend(take.time - take.time[0] + time[-1] + _PAUSE)
        starts = np.cumsum([0, *map(len, takes)]).tolist()
        joined = Take(
            np.array(time[1:]),
            np.concatenate([take.positions for take in takes]),
            np.concatenate([take.state for take in takes]),
            takes[0].skeleton,
            takes[0].source,
            by_kinect=takes[0].by_kinect,
        )
        yield Case(joined, list(zip(group, starts, strict=False))[1::3])


def _cleaned(
    take: Take, unhidden: Take, cleaner: Cleaner, options: HiddenLimbs
) -> tuple[Array, Array | None, tuple[float, float]]:
    """Return the clip's joint positions [m], their uncertainty, and tilt and roll."""
    if not options.live:
        clip = cleaner.clean(take).clip
        return clip.positions, clip.uncertainty, (clip.tilt, clip.roll)
    return followed(cleaner, take, unhidden), None, (0.0, 0.0)


def _measure(cases: list[Case], trained: _Ready, options: HiddenLimbs) -> list[Record]:
    """Clean takes with a system, once with nothing hidden and once for each limb."""
    system, corrector, prior = trained
    records, method, cleaner = [], system.label, _cleaner(system.config)
    if corrector is not None:
        cleaner = cleaner.replaced(Correct(system.config, corrector))
    if prior is not None:
        cleaner = with_prior(cleaner, system.config, prior)
    for case in cases:
        take, skeleton = case.take, case.take.skeleton
        seen, _, turn = _cleaned(take, take, cleaner, options)
        for gap, limb in product(options.gaps, options.limbs):
            spans = [(*h, s) for h in case.hidden if (s := middle(h[0].take, gap))]
            if not spans:
                continue
            joints = [skeleton.index(j) for j in HIDDEN[limb] if j in skeleton.joints]
            scored = [j for j in joints if skeleton.joints[j] in LIMBS]
            blind, with_spline = take, take.positions.copy()
            for pair, start, span in spans:
                gap_rows = slice(start + span.start, start + span.stop)
                seed = zlib.crc32(pair.clip.encode())
                blind = hide(blind, joints, gap_rows, options.guess, seed)
                rows = slice(start, start + len(pair.take))
                guesses = simple_guesses(with_spline[rows], skeleton, joints, span)
                with_spline[rows] = guesses["spline"]
            cleaned, uncertainty, _ = _cleaned(blind, take, cleaner, options)
            drawn = replace(take, positions=with_spline)
            spline, _, _ = _cleaned(drawn, take, cleaner, options)
            for pair, start, span in spans:
                rows = slice(start, start + len(pair.take))
                motions = simple_guesses(seen[rows], skeleton, joints, span)
                motions |= {"spline": spline[rows], method: cleaned[rows]}
                motions |= {"seen": seen[rows], "mocap": leveled(pair.truth, *turn)}
                limbs = {}
                for name, motion in motions.items():
                    hips = motion[span][:, skeleton.hips].mean(1, keepdims=True)
                    limbs[name] = motion[span][:, scored] - hips
                mocap = limbs.pop("mocap")
                within = None
                if uncertainty is not None:
                    limits = uncertainty[rows][span][:, scored, None]
                    within = within_uncertainty(np.abs(limbs[method] - mocap) / limits)
                record: Record = {"person": pair.subject, "movement": pair.movement}
                record |= {"clip": pair.clip, "limb": limb, "gap": gap}
                record |= {"method": method, "unhidden": _errors(limbs, limbs["seen"])}
                record |= {"mocap": _errors(limbs, mocap), "within": within}
                records.append(record)
    return records


def _errors(limbs: dict[str, Array], truth: Array) -> dict[str, float | None]:
    away = {k: np.linalg.norm(limb - truth, axis=2) * 100 for k, limb in limbs.items()}
    known = ~np.isnan(next(iter(away.values())))
    return {k: float(a[known].mean()) if known.any() else None for k, a in away.items()}


def summarize(records: Sequence[Record], by: By | None = None) -> list[Record]:
    """Return a row for each limb, value of ``by``, and method or baseline.

    Means are over clips, then over people. Baselines are those of the last method's
    clips, but percentages of hold relate each method to hold on its own clips.
    """
    groups: dict[tuple[str, str, str], list[Record]] = {}
    for record in records:
        key = (record["limb"], record[by] if by else "", record["method"])
        groups.setdefault(key, []).append(record)
    methods = list(dict.fromkeys(method for _, _, method in groups))
    rows = []
    for limb, part in dict.fromkeys(key[:2] for key in groups):
        for name in ("seen", *SIMPLE, *methods):
            group = groups[limb, part, name if name in methods else methods[-1]]
            errors = [r["unhidden"] for r in group]
            worse = [e[name] > min(e["hold"], e["slerp"]) + _WORSE for e in errors]
            error, hold = (_mean(group, "unhidden", row) for row in (name, "hold"))
            known = [r["within"] for r in group if r["within"] and name in methods]
            row = {"limb": limb, "part": part, "row": name, "clips": len(group)}
            row["unhidden_cm"] = error
            row["percent_of_hold"] = (error or 0.0) / hold * 100 if hold else None
            row["mocap_cm"] = _mean(group, "mocap", name)
            row["worse_percent"] = float(np.mean(worse) * 100)
            row["within_percent"] = np.mean(known, axis=0).tolist() if known else None
            rows.append(row)
    return rows


def _mean(records: Sequence[Record], key: str, row: str) -> float | None:
    people: dict[str, list[float]] = {}
    for record in records:
        if record[key][row] is not None:
            people.setdefault(record["person"], []).append(record[key][row])
    return float(np.mean([np.mean(p) for p in people.values()])) if people else None


def as_table(rows: Sequence[Record], title: str, by: By | None = None) -> Table:
    """Return the rows of ``summarize`` for a terminal."""
    parts = [Column(name, no_wrap=True) for name in ("limb", *([by] if by else []))]
    table = Table(*parts, Column(overflow="fold"), title=title, pad_edge=False)
    for heading in ("clips", "cm", "% of hold", "cm to mocap", "worse %", "within"):
        width = max(4, *map(len, heading.split()))
        table.add_column(heading, justify="right", min_width=width)
    for row in rows:
        figures = [row["unhidden_cm"], row["percent_of_hold"], row["mocap_cm"]]
        digits = zip([*figures, row["worse_percent"]], (1, 0, 1, 0), strict=True)
        table.add_row(
            row["limb"],
            *([row["part"]] if by else []),
            row["row"],
            str(row["clips"]),
            *("" if value is None else f"{value:.{n}f}" for value, n in digits),
            ", ".join(f"{share:.0f}" for share in row["within_percent"] or ()),
        )
    table.caption = (
        "cm: error of the hidden joints relative to the hips, against the clip with "
        "nothing hidden; % of hold: of the error of hold, cleaned by the same method; "
        "worse: clips over 1 cm worse than the better of hold and slerp; within: % of "
        "coordinates with errors to mocap below their uncertainty, and below 1.96 "
        "times it"
    )
    return table
