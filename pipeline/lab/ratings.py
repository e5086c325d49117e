"""Statistics of the grades that raters gave on a page of ``rating``.

Shum et al. 2013 (Figure 6) name no test. Here every two systems are compared by
Wilcoxon's signed-rank test, because all raters grade both and grades need not be
normal, corrected after Holm 1979 (Scandinavian Journal of Statistics 6).
"""

import json
from collections.abc import Sequence
from itertools import chain, combinations, permutations, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Column, Table
from scipy import stats

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, shown
from kinefilter.pipeline.formats.files import read_limited
from kinefilter.pipeline.formats.plain import counted, printable

from .rating import HIGHEST

Figures = dict[str, Any]
Answer = tuple[tuple[int, ...], tuple[int, ...]]  # clips of a trial in the key, grades
Raters = dict[str, list[Answer]]  # answers, by rater

_LARGEST = 2**24  # bytes of answers, or of a key
_LEVEL = 0.95
_FAR_APART = 3.0  # grades between two looks at the same clip; a guess


class Key(NamedTuple):
    """The systems and motions behind the clips of a page."""

    page: str
    systems: list[str]
    motions: list[str]
    clips: list[tuple[int, int]]  # system and motion of each
    trials: list[tuple[int, ...]]  # clips of each, sorted


def read_key(path: Path) -> Key:
    """Read the key of a page, or raise an InputError."""
    content = _read(path)
    try:
        systems, motions = (
            [printable(name) for name in content[key]] for key in ("systems", "motions")
        )
        clips = [
            (systems.index(clip["system"]), motions.index(clip["motion"]))
            for clip in content["clips"]
        ]
        trials = [tuple(sorted(trial)) for trial in content["trials"]]
        every = product(range(len(systems)), range(len(motions)))
        whole = len(systems) > 1 and sorted(clips) == list(every)
        whole = whole and {*chain.from_iterable(trials)} == {*range(len(clips))}
        if not whole or {len(trial) for trial in trials} not in ({1}, {2}):
            raise ValueError
        return Key(str(content["page"]), systems, motions, clips, trials)
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{path}: not the key of a page; give the file that 'kinefilter rate' "
            "wrote beside the page"
        ) from None


def read_answers(paths: Sequence[Path], key: Key) -> Raters:
    """Read answers, or raise an InputError unless all fit the key and are complete."""
    raters: Raters = {}
    for path in paths:
        rater, answers = _answers_in(path, key)
        if rater in raters:
            raise InputError(
                f"{path}: a second file of rater {rater!r}; keep one of the two, or "
                "change the name in one if they are two people"
            )
        raters[rater] = answers
    if not raters:
        raise InputError("no answers given; name the files that raters have saved")
    return raters


def _answers_in(path: Path, key: Key) -> tuple[str, list[Answer]]:
    content = _read(path)
    page, rater, given = (content.get(name) for name in ("page", "rater", "answers"))
    if page != key.page:
        other = "of no page" if page is None else f"of page {shown(page)}"
        raise InputError(
            f"{path}: answers {other}; the key is of page {shown(key.page)}"
        )
    try:
        rows = [(k["shown"], tuple(k["grades"])) for k in given or ()]
        answers = [(tuple(map(int, clips)), grades) for clips, grades in rows]
        seen = sorted(tuple(sorted(clips)) for clips, _ in answers)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: damaged answers; ask for the file again") from None
    if seen != sorted(key.trials) or not isinstance(rater, str) or not rater.strip():
        raise InputError(
            f"{path}: not the {len(key.trials)} answers of a rater to this page; ask "
            "for the file again"
        )
    for n, (clips, grades) in enumerate(answers):
        valid = [type(g) is int and 1 <= g <= HIGHEST for g in grades]  # not bool
        if len(grades) != len(clips) or not all(valid):
            raise InputError(
                f"{path}: answer {n + 1} has grades {shown(list(grades))}, expected "
                f"{len(clips)} from 1 to {HIGHEST}; ask the rater to finish"
            )
    return printable(rater), answers


def _read(path: Path) -> Figures:
    try:
        content = json.loads(read_limited(path, _LARGEST))
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError(f"{path}: not JSON of 'kinefilter rate' or its page")
    return content


def summarize(raters: Raters, key: Key) -> Figures:
    """Return statistics of systems, of pairs of systems, and of raters.

    If a rater graded a clip several times, the mean counts. Confidence intervals are
    Student's, over raters; NaN for a single rater.
    """
    grades = np.array([_grades(answers, key) for answers in raters.values()])  # R, S, M
    means, by_motion = grades.mean(axis=2), grades.mean(axis=0)
    count = len(key.systems)
    # How often a had a higher grade than b, the same and a lower one, [a, b, :].
    compared = np.zeros((count, count, 3), dtype=int)
    for clips, given in chain.from_iterable(raters.values()):
        for (a, first), (b, second) in permutations(zip(clips, given, strict=True), 2):
            outcome = 1 - np.sign(first - second)
            compared[key.clips[a][0], key.clips[b][0], outcome] += 1
    preferred = compared.sum(axis=1) @ [1.0, 0.5, 0.0]
    met = compared.sum(axis=(1, 2))
    systems = {
        name: {
            **_mean(means[:, s]),
            "sd": float(grades[:, s].std(ddof=1)) if grades[:, s].size > 1 else np.nan,
            "preferred": float(preferred[s] / met[s]) if met[s] else np.nan,
            "motions": dict(zip(key.motions, by_motion[s].tolist(), strict=True)),
        }
        for s, name in enumerate(key.systems)
    }
    pairs: list[Figures] = [
        {
            "systems": [key.systems[a], key.systems[b]],
            **_mean(means[:, a] - means[:, b]),
            "p": wilcoxon(means[:, a] - means[:, b]),
            "better": compared[a, b, [0, 2]].tolist(),
            "equal": int(compared[a, b, 1]),
        }
        for a, b in combinations(range(count), 2)
    ]
    for pair, p in zip(pairs, holm([pair["p"] for pair in pairs]), strict=True):
        pair["p_holm"] = p
    agreement = {rater: _agreement(answers) for rater, answers in raters.items()}
    return {"page": key.page, "systems": systems, "pairs": pairs, "raters": agreement}


def _grades(answers: Sequence[Answer], key: Key) -> Array:
    total = np.zeros((2, len(key.systems), len(key.motions)))
    for clips, grades in answers:
        for clip, grade in zip(clips, grades, strict=True):
            total[(slice(None), *key.clips[clip])] += grade, 1.0
    return np.asarray(total[0] / total[1])


def _mean(values: Array) -> Figures:
    low = high = np.nan
    if len(values) > 1:
        half = stats.sem(values) * stats.t.ppf((1 + _LEVEL) / 2, len(values) - 1)
        low, high = values.mean() - half, values.mean() + half
    return {"mean": float(values.mean()), "ci95": [float(low), float(high)]}


def wilcoxon(differences: Array) -> float:
    """Return the p-value of Wilcoxon's signed-rank test, 1 without any difference."""
    differences = np.round(differences, 9)  # equal means may differ by rounding
    return float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple testing, in the same order (Holm 1979)."""
    order = np.argsort(p)
    factors = len(p) - np.arange(len(p))
    raised = np.minimum(np.maximum.accumulate(np.asarray(p)[order] * factors), 1.0)
    return [float(value) for value in raised[np.argsort(order)]]


def _agreement(answers: Sequence[Answer]) -> Figures:
    first: dict[tuple[int, ...], dict[int, int]] = {}
    twice = reversals = 0
    apart = []
    for clips, grades in answers:
        now = dict(zip(clips, grades, strict=True))
        before = first.setdefault(tuple(sorted(clips)), now)
        if before is now:
            continue
        twice += 1
        apart += [abs(now[clip] - before[clip]) for clip in now]
        a, b = clips[0], clips[-1]
        reversals += (now[a] - now[b]) * (before[a] - before[b]) < 0
    return {
        "same_grade": len({grade for _, grades in answers for grade in grades}) == 1,
        "twice": twice,
        "reversed": int(reversals),
        "apart": float(np.mean(apart)) if apart else np.nan,
    }


def as_tables(figures: Figures) -> tuple[Table, Table]:
    """Return tables of the systems and of their pairs for the terminal."""

    def right(*headings: str) -> list[Column]:
        return [Column(name, justify="right", no_wrap=True) for name in headings]

    columns = right("mean", "95 % interval", "SD", "preferred")
    systems = Table("system", *columns, title=f"grades, 1 to {HIGHEST}")
    for name, row in figures["systems"].items():
        preferred = _figure(100 * row["preferred"], 0, " %")
        systems.add_row(name, *_interval(row), _figure(row["sd"]), preferred)
    systems.caption = (
        f"{counted(len(figures['raters']), 'rater')}; preferred: share of the pairs in "
        "which the system had the higher grade"
    )
    columns = right("mean", "95 % interval", "p", "Holm", "more, same, less")
    pairs = Table("difference", *columns, title="pairs of systems")
    for row in figures["pairs"]:
        better, worse = row["better"]
        counts = f"{better}, {row['equal']}, {worse}" if better + worse else ""
        ps = [_figure(row[p], 4) for p in ("p", "p_holm")]
        pairs.add_row(" - ".join(row["systems"]), *_interval(row), *ps, counts)
    pairs.caption = "p: Wilcoxon's signed-rank test over raters, and after Holm"
    return systems, pairs


def doubts(figures: Figures) -> list[str]:
    """Return sentences about raters whose grades are all equal or inconsistent."""
    sentences = []
    for rater, row in figures["raters"].items():
        if row["same_grade"]:
            sentences.append(f"{rater} gave everything the same grade")
        if row["reversed"]:
            sentences.append(
                f"{rater} preferred the other clip the second time in "
                f"{row['reversed']} of {counted(row['twice'], 'repeated trial')}"
            )
        elif row["apart"] >= _FAR_APART:
            sentences.append(
                f"{rater} graded the same clips {row['apart']:.1f} apart on average "
                "the second time"
            )
    return sentences


def _interval(row: Figures) -> tuple[str, str]:
    low, high = map(_figure, row["ci95"])
    return _figure(row["mean"]), f"{low} to {high}" if low else ""


def _figure(value: float, digits: int = 2, unit: str = "") -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}{unit}"
