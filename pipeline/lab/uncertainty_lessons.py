"""Trains the uncertainty of joints, on people that are new to the corrector.

``python -m kinefilter.pipeline.lab.uncertainty_lessons OUT.toml PAIRS...`` rewrites the
weights of ``uncertainty``. For each person it prints the share of coordinates within
the uncertainty and within 1.96 times the uncertainty, by weights trained without them.
"""

import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from scipy.optimize import minimize

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.skeleton import LIMB_PARTS
from kinefilter.pipeline import uncertainty
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.correct import LearnedCorrector
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import Mode
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

from .accuracy import within_uncertainty
from .hidden_limb_evaluation import join_cases
from .limb_guesses import HIDDEN, Guess, hide
from .limb_lessons import joined, read_lessons, train_prior, with_prior
from .recorded_acts import NamedTake
from .training import teach, training_set

Weights = dict[str, dict[str, list[float]]]

_EVERY = 3  # use every third clip
_HIDDEN = ("left-arm", "right-arm", "arms", "left-leg", "right-leg", "shins", "hands")
_GAPS = (0.3, 1.0, 2.0)  # s
_SEEN_BEFORE = 5  # frames before a gap
_FREEDOM = 4.0  # degrees of freedom of Student's t, the distribution of errors
_WITHIN = 1.25  # scales: covers 72 % of the errors, and 1.96 times as much covers 93 %
_SHRINKAGE = 0.003


class Rows(NamedTuple):
    """Features from ``describe`` and errors of a person's judged joints."""

    person: str
    seen: Array
    gone: Array
    hidden: Flags
    away: Array  # errors relative to the middle of the hips [m], (T, 2 P, 3)


def lessons(
    corrector: LearnedCorrector,
    pairs: Sequence[PairedTake],
    every: int = _EVERY,
    prior: MotionPrior | None = None,
) -> Rows:
    """Return the training data of a person from every Nth of their clips.

    Each is cleaned as it is and with a limb hidden, by a corrector and a prior (by
    default the shipped one) that were not trained on the person.
    """
    cleaner, parts = Cleaner(corrector=corrector), []
    if prior is not None:
        cleaner = with_prior(cleaner, CleanConfig(), prior)
    alone = list(join_cases(pairs, "alone"))[::every]
    repeated = [case for case in join_cases(pairs, "repetitions") if case.hidden]
    for case in (*alone, *repeated[::2]):
        blind, skeleton = case.take, case.take.skeleton
        mocap = np.full(blind.positions.shape, np.nan)
        for pair, start in case.hidden:
            mocap[start : start + len(pair.take)] = pair.truth
            blind = _without_a_limb(blind, start, len(pair.take), pair.clip)
        for take in (case.take, blind):
            draft = cleaner.whole(take, silent)
            away = draft.positions - leveled(mocap, draft.tilt, draft.roll)
            away -= away[:, skeleton.hips].mean(axis=1, keepdims=True)
            away = away[:, uncertainty.judged(skeleton)]
            parts.append((*uncertainty.describe(draft), away))
    columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Rows(pairs[0].subject, *columns)


def _without_a_limb(take: Take, first: int, count: int, clip: str) -> Take:
    """Return a take in which a limb is hidden; the clip's name draws which and when."""
    number, limb = divmod(zlib.crc32(clip.encode()), len(_HIDDEN))
    number, gap = divmod(number, len(_GAPS))
    number, place = divmod(number, 3)
    room = count - 2 * _SEEN_BEFORE
    length = min(round(_GAPS[gap] * take.fps), room)
    start = first + (_SEEN_BEFORE + (room - length) // 2 if place else count - length)
    names = (name for name in HIDDEN[_HIDDEN[limb]] if name in take.skeleton.joints)
    joints = [take.skeleton.index(name) for name in names]
    guess: Guess = "drift" if number % 2 else "none"
    return hide(take, joints, slice(start, start + length), guess, number)


def fit(rows: Sequence[Rows]) -> Weights:
    """Return bias and weights of each part's log uncertainty [m], seen and hidden."""
    weights: Weights = {"seen": {}, "hidden": {}}
    for table, missing in (("seen", False), ("hidden", True)):
        for k, part in enumerate(LIMB_PARTS):
            # Shoulders and hips are never hidden; they take the next joint's weights.
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
    """Return the maximum-likelihood bias and weights of the scale of Student's t."""
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
    best = minimize(loss, start, jac=True, method="L-BFGS-B").x
    scales = best[1:] / spread
    bias = best[0] - scales @ mean + np.log(_WITHIN)
    return [round(float(number), 4) for number in (bias, *scales)]


def within(weights: Weights, rows: Rows) -> dict[str, tuple[float, float] | None]:
    """Return ``within_uncertainty`` for seen and for hidden joints."""
    logs = uncertainty.log_uncertainty(weights, rows.seen, rows.gone, rows.hidden)
    shares = np.abs(rows.away) / np.exp(logs)[..., None]
    return {
        "seen": within_uncertainty(shares[~rows.hidden]),
        "hidden": within_uncertainty(shares[rows.hidden]),
    }


def _person(person: str, pairs: Sequence[PairedTake], prior: MotionPrior) -> Rows:
    others = [pair for pair in pairs if pair.subject != person]
    mine = [pair for pair in pairs if pair.subject == person]
    return lessons(teach("learned", training_set(others)), mine, prior=prior)


def main(out: Path, files: Sequence[str]) -> None:
    """Train on pairs files, and write the weights."""
    pairs = [pair for file in files for pair in read_pairs(file)]
    people = sorted({pair.subject for pair in pairs})
    taught = read_lessons(map(NamedTake.of, pairs), get_args(Mode))
    with workers() as pool:
        jobs = []
        for person in people:
            of_others = joined(one for one in taught if one.person != person)
            prior = train_prior(of_others, pool)
            jobs.append(pool.submit(_person, person, pairs, prior))
        rows = [job.result() for job in jobs]
    for mine in rows:
        others = [row for row in rows if row is not mine]
        print(mine.person, within(fit(others), mine))
    weights = fit(rows)
    lines = ["# Written by kinefilter.pipeline.lab.uncertainty_lessons: bias, weights."]
    for table, names in (("seen", uncertainty.SEEN), ("hidden", uncertainty.HIDDEN)):
        lines += ["", f"[{table}] # {', '.join(names)}"]
        lines += [f"{part} = {numbers}" for part, numbers in weights[table].items()]
    out.write_text("\n".join(lines) + "\n", "utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
