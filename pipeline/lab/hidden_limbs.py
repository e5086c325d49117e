"""How near a limb that was hidden comes to where it was seen, on recorded people.

A limb that the sensor saw is hidden in the middle of a clip, the take is cleaned, and
the hidden joints are compared with those of the take cleaned with nothing hidden, and
with marker mocap, beside the simplest guesses.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from rich.table import Table

from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.correct import Corrector
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reliability import measure_body
from kinefilter.pipeline.stages import Correct
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .accuracy import LIMBS, within_uncertainty
from .limb_guesses import HIDDEN, SIMPLE, Guess, hide, simple_guesses
from .limb_lessons import (
    Lesson,
    Recording,
    joined,
    knowing,
    read_lessons,
    recordings_in,
    teach_limbs,
)
from .systems import School, System, as_step, systems_of

Context = Literal["alone", "repetitions"]
By = Literal["movement", "gap", "person"]
Record = dict[str, Any]

_SEEN = 5  # frames that a limb must be seen for before and after a gap
_PAUSE = 2.0  # s between the repetitions in a take
_WORSE = 1.0  # cm by which a clip is worse than the better of hold and slerp
_A_JOB = 8  # takes that a process cleans before it reports


@dataclass(frozen=True)
class HiddenLimbs:
    """What is hidden, and how takes are cleaned; see ``evaluate --help``."""

    limbs: tuple[str, ...]
    gaps: tuple[str, ...] = ("55%",)
    guess: Guess = "none"
    context: Context = "alone"
    live: bool = False
    physics: bool = True

    def __post_init__(self) -> None:
        for limb in self.limbs:
            if limb not in HIDDEN:
                raise InputError(f"unknown limb {limb!r}; known: {', '.join(HIDDEN)}")
        for gap in self.gaps:
            _frames(gap, 100, 30.0)


class Case(NamedTuple):
    """A take, and its clips in which a limb is hidden, with their first rows."""

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
    """Hide limbs in clips and measure what cleaning makes of them.

    Args:
        pairs: Clips; people are told apart by ``subject``.
        methods: Names as ``systems_of`` has them. Those that learn are taught by the
            clips of the other people, in which nothing is hidden.
        options: What is hidden.
        recordings: If there are any, what limbs mostly do is learned from these and
            the clips of the other people; else it is what ships.
        presets: Names out of ``PRESETS``, likewise.
        assigned: Parameters of all of them, NAME=VALUE.
        every: Clean only every Nth take.
        progress: Wraps the loop over takes, for a progress bar.

    Returns:
        A record of each gap, and how many gaps were too long for their clip. Its errors
        [cm] are means over frames and joints: of the method, of the ``seen`` clip and
        of ``SIMPLE``, against the seen clip (``unhidden``) and against ``mocap``.
        ``within``: per cent of hidden coordinates nearer to mocap than their
        uncertainty, and than 1.96 times that; None live, and without mocap.

    Raises:
        InputError: Unknown methods, or no clip in which the gaps fit.
    """
    systems = systems_of(methods, presets, assigned, physics=options.physics)
    cases = list(join_cases(pairs, options.context))[:: as_step(every)]
    takes = [pair.take for case in cases for pair, _ in case.hidden]
    spans = [middle(take, gap) for take in takes for gap in options.gaps]
    skipped = spans.count(None)
    if skipped == len(spans):
        raise InputError(
            f"a gap of {', '.join(options.gaps)} fits into no clip with {_SEEN} frames "
            f"before and after it ({skipped} tried); give a shorter one"
        )
    jobs = (
        (some[k : k + _A_JOB], taught, options)
        for some, several in _folds(
            systems, cases, pairs, recordings, options, progress
        )
        for k in range(0, len(some), _A_JOB)
        for taught in several
    )
    if len(cases) <= _A_JOB:
        return [record for job in jobs for record in _measure(*job)], skipped
    with workers() as pool:
        waiting = [pool.submit(_measure, *job) for job in jobs]
        done = [job.result() for job in over(waiting, "hide and clean", progress)]
    return [record for records in done for record in records], skipped


class _Taught(NamedTuple):
    """A system, and what it has learned: None is what its config makes, and ships."""

    system: System
    corrector: Corrector | None = None
    prior: MotionPrior | None = None


def _folds(
    systems: Sequence[System],
    cases: list[Case],
    pairs: Sequence[PairedTake],
    recordings: Sequence[Path],
    options: HiddenLimbs,
    progress: Progress,
) -> Iterator[tuple[list[Case], list[_Taught]]]:
    """Yield takes, and what cleans them."""
    learning = [system for system in systems if system.learns or recordings]
    yield cases, [_Taught(system) for system in systems if system not in learning]
    people = sorted({pair.subject for pair in pairs}) if learning else []
    if len(people) == 1:
        raise InputError(
            f"{learning[0].label} learns from other people; give pairs files of two or "
            "more"
        )
    lessons: list[Lesson] = []
    if recordings:
        read = [one for file in recordings for one in recordings_in(file)]
        read += map(Recording.of, pairs)
        lessons = read_lessons(over(read, "read", progress), (not options.live,))
    for person in people:
        some = [c for c in cases if c.hidden and c.hidden[0][0].subject == person]
        if not some:
            continue
        school = School(
            [pair for pair in pairs if pair.subject != person],
            some[0].take.skeleton,
            people=False,
            database=builtin_database(some[0].take.skeleton),
            progress=progress,
        )
        others = joined(lesson for lesson in lessons if lesson.person != person)
        prior = teach_limbs(others) if recordings else None
        yield (
            some,
            [
                _Taught(s, school.corrector(s) if s.learns else None, prior)
                for s in learning
            ],
        )


def _frames(gap: str, count: int, fps: float) -> int:
    """Return how many frames of a clip of ``count`` a gap takes."""
    share, number = gap.endswith("%"), gap.removesuffix("%")
    known = re.fullmatch(r"\d{0,4}\.?\d{1,9}", number)
    if not known or (share and float(number) >= 100):
        raise InputError(f"gap {gap!r}: expected seconds, such as 0.3, or 55%")
    return round(count * float(number) / 100 if share else float(number) * fps)


def middle(take: Take, gap: str) -> slice | None:
    """Return the frames in the middle of a clip that a gap takes, if they fit."""
    count = _frames(gap, len(take), take.fps)
    start = (len(take) - count) // 2
    return slice(start, start + count) if count > 0 and start >= _SEEN else None


def join_cases(pairs: Sequence[PairedTake], context: Context) -> Iterator[Case]:
    """Yield takes: each clip, or all repetitions, of which every third is hidden."""
    if context == "alone":
        yield from (Case(pair.take, [(pair, 0)]) for pair in pairs)
        return
    groups: dict[tuple[str, str], list[PairedTake]] = {}
    for pair in sorted(pairs, key=lambda pair: pair.clip):
        name = re.sub(r"_e\d+", "", pair.clip)
        if name == pair.clip:
            raise InputError(
                f"{pair.take.source}: the clip's name tells no repetition; expected "
                "one such as m01_s02_e05, or use --context alone"
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
        )
        yield Case(joined, list(zip(group, starts, strict=False))[1::3])


@cache
def _cleaner(system: System) -> Cleaner:
    return Cleaner(system.config)


def _cleaned(
    take: Take, unhidden: Take, cleaner: Cleaner, options: HiddenLimbs
) -> tuple[Array, Array | None, float]:
    """Return joint positions of the clean clip [m], their uncertainty, and the tilt."""
    if not options.live:
        clip = cleaner.clean(take).clip
        return clip.positions, clip.uncertainty, clip.tilt
    cleaner.start(measure_body(unhidden))
    frames = zip(take.positions, take.time.tolist(), take.state, strict=True)
    positions = np.array([cleaner.step(*frame).positions for frame in frames])
    return positions, None, 0.0


def _measure(cases: list[Case], taught: _Taught, options: HiddenLimbs) -> list[Record]:
    """Clean takes by a system, once with nothing hidden and once for each limb."""
    system, corrector, prior = taught
    found, method, cleaner = [], system.label, _cleaner(system)
    if corrector is not None:
        cleaner = cleaner.replaced(Correct(system.config, corrector))
    if prior is not None:
        cleaner = knowing(cleaner, system.config, prior)
    for case in cases:
        take, skeleton = case.take, case.take.skeleton
        seen, sure, tilt = _cleaned(take, take, cleaner, options)
        for gap, limb in product(options.gaps, options.limbs):
            joints = [skeleton.index(j) for j in HIDDEN[limb] if j in skeleton.joints]
            scored = [j for j in joints if skeleton.joints[j] in LIMBS]
            spans = [(*h, s) for h in case.hidden if (s := middle(h[0].take, gap))]
            blind, places = take, take.positions.copy()
            for pair, start, span in spans:
                rows = slice(start + span.start, start + span.stop)
                seed = zlib.crc32(pair.clip.encode())
                blind = hide(blind, joints, rows, options.guess, seed)
                rows = slice(start, start + len(pair.take))
                drawn = simple_guesses(places[rows], skeleton, joints, span)
                places[rows] = drawn["spline"]
            hidden = spline = seen
            if spans:
                hidden, sure, _ = _cleaned(blind, take, cleaner, options)
                drawn_into = replace(take, positions=places)
                spline, _, _ = _cleaned(drawn_into, take, cleaner, options)
            for pair, start, span in spans:
                rows = slice(start, start + len(pair.take))
                motions = simple_guesses(seen[rows], skeleton, joints, span)
                motions["spline"] = spline[rows]
                motions |= {method: hidden[rows], "seen": seen[rows]}
                motions["mocap"] = leveled(pair.truth, tilt)
                middles = {k: m[span][:, skeleton.hips] for k, m in motions.items()}
                limbs = {
                    name: motion[span][:, scored] - middles[name].mean(1, keepdims=True)
                    for name, motion in motions.items()
                }
                mocap = limbs.pop("mocap")
                within = None
                if sure is not None:
                    shares = np.abs(limbs[method] - mocap)
                    shares /= sure[rows][span][:, scored, None]
                    within = within_uncertainty(shares)
                found.append(
                    {
                        "person": pair.subject,
                        "movement": pair.movement,
                        "clip": pair.clip,
                        "limb": limb,
                        "gap": gap,
                        "method": method,
                        "unhidden": _errors(limbs, limbs["seen"]),
                        "mocap": _errors(limbs, mocap),
                        "within": within,
                    }
                )
    return found


def _errors(limbs: dict[str, Array], truth: Array) -> dict[str, float | None]:
    """Return mean distances [cm], None where there is no truth."""
    away = {k: np.linalg.norm(limb - truth, axis=2) * 100 for k, limb in limbs.items()}
    known = ~np.isnan(next(iter(away.values())))
    return {k: float(a[known].mean()) if known.any() else None for k, a in away.items()}


def summarize(records: Sequence[Record], by: By | None = None) -> list[Record]:
    """Return a row for each limb, part of the records and method or simple guess.

    Means are over clips, then over people. The simple guesses are those made on the
    clips of the last method, but each method's per cent are of hold on its own clips.

    Args:
        records: From ``measure_hidden``.
        by: What the records are split by.
    """
    rows = []
    methods = list(dict.fromkeys(r["method"] for r in records))
    for limb, part in dict.fromkeys((r["limb"], r[by] if by else "") for r in records):
        for name in ("seen", *SIMPLE, *methods):
            some = [
                r
                for r in records
                if (r["limb"], r[by] if by else "") == (limb, part)
                and r["method"] == (name if name in methods else methods[-1])
            ]
            errors = [r["unhidden"] for r in some]
            worse = [e[name] > min(e["hold"], e["slerp"]) + _WORSE for e in errors]
            away, hold = (_mean(some, "unhidden", row) for row in (name, "hold"))
            row = {"limb": limb, "part": part, "row": name, "clips": len(some)}
            row["unhidden_cm"] = away
            row["percent_of_hold"] = (away or 0.0) / hold * 100 if hold else None
            row["mocap_cm"] = _mean(some, "mocap", name)
            row["worse_percent"] = float(np.mean(worse) * 100)
            told = [r["within"] for r in some if r["within"]] if name in methods else []
            row["within_percent"] = np.mean(told, axis=0).tolist() if told else None
            rows.append(row)
    return rows


def _mean(records: Sequence[Record], key: str, row: str) -> float | None:
    people: dict[str, list[float]] = {}
    for record in records:
        if record[key][row] is not None:
            people.setdefault(record["person"], []).append(record[key][row])
    return float(np.mean([np.mean(p) for p in people.values()])) if people else None


def as_table(rows: Sequence[Record], title: str, by: By | None = None) -> Table:
    """Return what ``summarize`` found, for a terminal."""
    table = Table("limb", *([by] if by else []), "", title=title)
    for heading in ("clips", "cm", "% of hold", "cm to mocap", "worse %", "within"):
        table.add_column(heading, justify="right", no_wrap=True)
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
        "cm: hidden joints relative to the hips, against the clip with nothing hidden; "
        "worse: clips over 1 cm worse than the better of hold and slerp; within: % of "
        "coordinates nearer to mocap than their uncertainty, and than 1.96 times that"
    )
    return table
