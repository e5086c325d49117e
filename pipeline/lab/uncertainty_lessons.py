"""Learns how uncertain joints are, from people whom the corrector did not learn from.

``python -m kinefilter.pipeline.lab.uncertainty_lessons OUT.toml PAIRS...`` writes the
weights of ``uncertainty`` again, and prints for each person how many coordinates lie
within the uncertainty and within 1.96 times as much, by weights that leave them out.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.uncertainty import (
    HIDDEN,
    PARTS,
    SEEN,
    describe,
    judged,
    log_uncertainty,
)
from kinefilter.pipeline.workers import workers

from .accuracy import within_uncertainty
from .hidden_limbs import join_cases
from .limb_guesses import HIDDEN as LIMBS
from .limb_guesses import Guess, hide
from .limb_lessons import knowing, taught_by
from .teach import teach
from .training import training_set

Weights = dict[str, dict[str, list[float]]]

_EVERY = 3  # clips
_HIDDEN = ("left-arm", "right-arm", "arms", "left-leg", "right-leg", "shins", "hands")
_GAPS = (0.3, 1.0, 2.0)  # s
_SEEN_BEFORE = 5  # frames before a gap
_FREEDOM = 4.0  # degrees of freedom of Student's t, which errors are taken for
_WITHIN = 1.25  # of its scale: 72 % of the errors, and 93 % within 1.96 times as much
_SHRINKAGE = 0.003


class Rows(NamedTuple):
    """Judged joints in frames of a person, as ``describe`` gives them."""

    person: str
    seen: Array
    gone: Array
    hidden: Flags
    away: Array
    """Errors relative to the middle of the hips [m], NaN where unknown, (T, 2 P, 3)."""


def lessons(
    corrector: LearnedCorrector,
    pairs: Sequence[PairedTake],
    every: int = _EVERY,
    prior: MotionPrior | None = None,
) -> Rows:
    """Clean clips of a person, each once as it is and once with a limb hidden.

    Args:
        corrector: Has not learned from the person.
        pairs: The person's clips.
        every: Clean every Nth clip.
        prior: Nor has this; by default it is the one that ships.
    """
    cleaner, found = Cleaner(corrector=corrector), []
    if prior is not None:
        cleaner = knowing(cleaner, CleanConfig(), prior)
    alone = list(join_cases(pairs, "alone"))[::every]
    repeated = [case for case in join_cases(pairs, "repetitions") if case.hidden]
    for case in (*alone, *repeated[::2]):
        skeleton = case.take.skeleton
        mocap = np.full(case.take.positions.shape, np.nan)
        blind = case.take
        for pair, start in case.hidden:
            mocap[start : start + len(pair.take)] = pair.truth
            blind = _without_a_limb(blind, start, len(pair.take), pair.clip)
        for take in (case.take, blind):
            draft = cleaner.whole(take, silent)
            away = draft.positions - leveled(mocap, draft.tilt)
            away -= away[:, skeleton.hips].mean(axis=1, keepdims=True)
            found.append((*describe(draft), away[:, judged(skeleton)]))
    columns = (np.concatenate(part) for part in zip(*found, strict=True))
    return Rows(pairs[0].subject, *columns)


def _without_a_limb(take: Take, first: int, count: int, clip: str) -> Take:
    """Return a take in which a limb is hidden for some of a clip's frames.

    Which limb, for how long, in the middle or up to the end: by the clip's name.
    """
    number, limb = divmod(zlib.crc32(clip.encode()), len(_HIDDEN))
    number, gap = divmod(number, len(_GAPS))
    number, place = divmod(number, 3)
    room = count - 2 * _SEEN_BEFORE
    length = min(round(_GAPS[gap] * take.fps), room)
    start = first + (_SEEN_BEFORE + (room - length) // 2 if place else count - length)
    names = (name for name in LIMBS[_HIDDEN[limb]] if name in take.skeleton.joints)
    joints = [take.skeleton.index(name) for name in names]
    guess: Guess = "drift" if number % 2 else "none"
    return hide(take, joints, slice(start, start + length), guess, number)


def fit(rows: Sequence[Rows]) -> Weights:
    """Return bias and weights of each part's uncertainty [ln m], seen and hidden."""
    weights: Weights = {"seen": {}, "hidden": {}}
    for table, missing in (("seen", False), ("hidden", True)):
        for k, part in enumerate(PARTS):
            # Whole shoulders and hips are not hidden: they are as what hangs on them.
            at = k + 1 if missing and part in ("Shoulder", "Hip") else k
            both, columns = slice(2 * at, 2 * at + 2), []
            for row in rows:
                away, features = row.away[:, both], row.gone if missing else row.seen
                known = ~np.isnan(away[..., 0]) & (row.hidden[:, both] == missing)
                shares = np.full(known.sum(), 1.0 / max(known.sum(), 1))
                columns.append((features[:, both][known], away[known], shares))
            joined = (np.concatenate(column) for column in zip(*columns, strict=True))
            weights[table][part] = _scale_of(*joined)
    return weights


def _scale_of(features: Array, away: Array, shares: Array) -> list[float]:
    """Return bias and weights for which errors are the likeliest Student's t."""
    mean = np.average(features, axis=0, weights=shares)
    spread = np.sqrt(np.average((features - mean) ** 2, axis=0, weights=shares))
    spread = np.maximum(spread, 1e-6)
    rows = np.column_stack([np.ones(len(away)), (features - mean) / spread])
    shares, squares = shares / shares.sum(), away**2

    def loss(weights: Array) -> tuple[float, Array]:
        logs = rows @ weights
        share = squares * np.exp(-2.0 * logs)[:, None]
        half = (_FREEDOM + 1.0) / 2.0
        costs = 3.0 * logs + half * np.log1p(share / _FREEDOM).sum(axis=1)
        slopes = 3.0 - 2.0 * half * (share / (_FREEDOM + share)).sum(axis=1)
        shrunk = np.append(0.0, weights[1:])
        value = shares @ costs + _SHRINKAGE * shrunk @ shrunk
        return value, rows.T @ (shares * slopes) + 2.0 * _SHRINKAGE * shrunk

    start = np.zeros(rows.shape[1])
    start[0] = 0.5 * np.log(shares @ squares.mean(axis=1))
    found = minimize(loss, start, jac=True, method="L-BFGS-B").x
    scales = found[1:] / spread
    bias = found[0] - scales @ mean + np.log(_WITHIN)
    return [round(float(number), 4) for number in (bias, *scales)]


def within(weights: Weights, rows: Rows) -> dict[str, tuple[float, float] | None]:
    """Return what ``within_uncertainty`` does, of seen and of hidden joints."""
    limits = np.exp(log_uncertainty(weights, rows.seen, rows.gone, rows.hidden))
    shares = np.abs(rows.away) / limits[..., None]
    return {
        "seen": within_uncertainty(shares[~rows.hidden]),
        "hidden": within_uncertainty(shares[rows.hidden]),
    }


def _person(person: str, pairs: Sequence[PairedTake]) -> Rows:
    """Return the lessons of a person, by a corrector that learned from the others."""
    others = [pair for pair in pairs if pair.subject != person]
    mine = [pair for pair in pairs if pair.subject == person]
    learned = teach("learned", training_set(others))
    return lessons(learned, mine, prior=taught_by(others))


def main(out: Path, files: Sequence[str]) -> None:
    """Learn from pairs files, and write the weights."""
    pairs = [pair for file in files for pair in read_pairs(file)]
    people = sorted({pair.subject for pair in pairs})
    with workers() as pool:
        jobs = [pool.submit(_person, person, pairs) for person in people]
        rows = [job.result() for job in jobs]
    for mine in rows:
        others = [row for row in rows if row is not mine]
        print(mine.person, within(fit(others), mine))
    weights = fit(rows)
    lines = ["# Written by kinefilter.pipeline.lab.uncertainty_lessons: bias, weights."]
    for table, names in (("seen", SEEN), ("hidden", HIDDEN)):
        lines += ["", f"[{table}] # {', '.join(names)}"]
        lines += [f"{part} = {numbers}" for part, numbers in weights[table].items()]
    out.write_text("\n".join(lines) + "\n", "utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
