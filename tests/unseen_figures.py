"""How far limbs that the sensor never sees are from where they are.

``python tests/unseen_figures.py TAKES... --train RECORDINGS...`` hides limbs throughout
recorded takes, cleans them, and compares their joints with those of the take cleaned
with nothing hidden, relative to the hips. Each person in a pairs file is left out of
the training in turn; of other files, all are. Rows without networks have what local PCA
fills in, and hanging limbs have the lengths that the sensor measures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from kinefilter.characters import Skeleton, State, Take
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.limb_guesses import HIDDEN
from kinefilter.pipeline.lab.limb_lessons import (
    Recording,
    joined,
    read_lessons,
    recordings_in,
    train_prior,
    with_prior,
)
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import HANGING

Array = NDArray[np.float64]
out = Console()
LIMBS = ("left-arm", "arms", "left-leg", "legs")
_FRAMES = 300  # of each take


def hidden_throughout(take: Take, joints: list[int]) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[:, joints], state[:, joints] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


def hanging(positions: Array, skeleton: Skeleton, joints: list[int]) -> Array:
    found = positions.copy()
    for j in (j for j in skeleton.order if j in joints):
        p = skeleton.parents[j]
        length = np.median(np.linalg.norm(positions[:, j] - positions[:, p], axis=1))
        found[:, j] = found[:, p] + length * HANGING
    return found


def errors(take: Take, plain: Cleaner, trained: Cleaner) -> Iterator[list[float]]:
    """Yield a take's errors [cm] for each of LIMBS: hanging, without, with networks."""
    seen, skeleton = trained.clean(take).clip.positions, take.skeleton
    for limb in LIMBS:
        joints = [skeleton.index(j) for j in HIDDEN[limb] if j in skeleton.joints]
        blind = hidden_throughout(take, joints)
        found = [hanging(seen, skeleton, joints)]
        found += [cleaner.clean(blind).clip.positions for cleaner in (plain, trained)]
        names = ("Elbow", "Wrist", "Knee", "Ankle")
        scored = [j for j in joints if skeleton.joints[j].startswith(names)]
        limbs = [
            motion[:, scored] - motion[:, skeleton.hips].mean(axis=1, keepdims=True)
            for motion in (seen, *found)
        ]
        yield [100 * np.linalg.norm(m - limbs[0], axis=2).mean() for m in limbs[1:]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("takes", type=Path, nargs="+")
    parser.add_argument("--train", type=Path, nargs="+", default=[])
    parser.add_argument("--every", type=int, default=25, help="test every Nth clip")
    options = parser.parse_args()
    pairs = {path for path in options.takes if path.suffix == ".npz"}
    tests = {path: list(recordings_in(path)) for path in options.takes}
    teachers = [one for path in options.train for one in recordings_in(path)]
    teachers += [one for path in pairs for one in tests[path]]
    lessons = read_lessons(teachers, ("unseen",))
    groups: dict[str, list[Recording]] = {}
    for path, recordings in tests.items():
        for one in recordings:
            groups.setdefault(one.person if path in pairs else "", []).append(one)
    rows = []
    for person, recordings in groups.items():
        prior = train_prior(joined(one for one in lessons if one.person != person))
        plain, trained = (
            with_prior(Cleaner(), CleanConfig(), each)
            for each in (MotionPrior({}), prior)
        )
        step = options.every if person else 1
        takes = [one.take.at(slice(_FRAMES)) for one in recordings[::step]]
        found = np.array([list(errors(take, plain, trained)) for take in takes])
        shown = found.mean(axis=0).round(1).tolist()
        out.print(f"{person or 'takes'} {len(takes)} {shown}", soft_wrap=True)
        rows.append(found.mean(axis=0))
    for limb, figures in zip(LIMBS, np.mean(rows, axis=0), strict=True):
        shown = figures.round(1).tolist()
        out.print(limb, "hanging, without networks, with, cm:", shown)


if __name__ == "__main__":
    main()
