"""How far limbs that the sensor sees late, no more, or never are from where they are.

``python tests/unseen_figures.py TAKES... --train RECORDINGS...`` hides limbs throughout
recorded takes, or with ``--hidden first-half second-half`` in one half of them and then
in the other. It cleans the takes and compares the hidden joints with those of the take
cleaned with nothing hidden, relative to the hips. Each person in a pairs file is left
out of the training in turn; of other files, all are. The simple guesses are that limbs
that are never seen hang down, and that others are held where they are seen next or were
last, both with the lengths that the sensor measures. Without networks, never seen limbs
are filled in by local PCA, and others come to rest.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from kinefilter.characters import Skeleton, State, Take
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.limb_guesses import HIDDEN
from kinefilter.pipeline.lab.limb_lessons import (
    joined,
    read_lessons,
    train_prior,
    with_prior,
)
from kinefilter.pipeline.lab.recorded_acts import NamedTake, recordings_in
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import HANGING, Mode
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame, find_yaw

Array = NDArray[np.float64]
out = Console()
LIMBS = ("left-arm", "arms", "left-leg", "legs")
SPANS = ["throughout", "first-half", "second-half"]
_FRAMES = 300  # of each take


def without(take: Take, joints: list[int], frames: slice) -> Take:
    positions, state = take.positions.copy(), take.state.copy()
    positions[frames, joints], state[frames, joints] = np.nan, State.NOT_TRACKED
    return replace(take, positions=positions, state=state)


def hanging(positions: Array, skeleton: Skeleton, joints: list[int]) -> Array:
    found = positions.copy()
    for j in (j for j in skeleton.order if j in joints):
        p = skeleton.parents[j]
        length = np.median(np.linalg.norm(positions[:, j] - positions[:, p], axis=1))
        found[:, j] = found[:, p] + length * HANGING
    return found


def held(
    positions: Array, skeleton: Skeleton, joints: list[int], frames: slice
) -> Array:
    yaw = find_yaw(positions, skeleton)
    heading = HeadingFrame(positions[:, skeleton.root], yaw)
    found = heading.remove(positions)
    nearest = frames.start - 1 if frames.start else frames.stop
    for j in (j for j in skeleton.order if j in joints):
        p = skeleton.parents[j]
        found[frames, j] = found[frames, p] + found[nearest, j] - found[nearest, p]
    return heading.restore(found)


def errors(
    take: Take, hidden: str, plain: Cleaner, trained: Cleaner
) -> Iterator[list[float]]:
    """Yield a take's errors [cm] for each of LIMBS: simple, without, with networks.

    The last row is the share of frames [%] in which a foot stands: of what was seen,
    without and with networks, where LIMBS[-1] is hidden.
    """
    whole, skeleton = trained.clean(take).clip, take.skeleton
    seen = whole.positions
    count, half = len(seen), len(seen) // 2
    spans = slice(0, count), slice(0, half), slice(half, count)
    frames = dict(zip(SPANS, spans, strict=True))[hidden]
    for limb in LIMBS:
        joints = [skeleton.index(j) for j in HIDDEN[limb] if j in skeleton.joints]
        blind = without(take, joints, frames)
        if hidden == SPANS[0]:
            found = [hanging(seen, skeleton, joints)]
        else:
            found = [held(seen, skeleton, joints, frames)]
        clips = [cleaner.clean(blind).clip for cleaner in (plain, trained)]
        found += [clip.positions for clip in clips]
        names = ("Elbow", "Wrist", "Knee", "Ankle")
        scored = [j for j in joints if skeleton.joints[j].startswith(names)]
        limbs = [
            motion[frames, scored]
            - motion[frames, skeleton.hips].mean(axis=1, keepdims=True)
            for motion in (seen, *found)
        ]
        yield [100 * np.linalg.norm(m - limbs[0], axis=2).mean() for m in limbs[1:]]
    stands = (clip.contacts[frames].any(axis=1) for clip in (whole, *clips))
    yield [100 * each.mean() for each in stands]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("takes", type=Path, nargs="+")
    parser.add_argument("--train", type=Path, nargs="+", default=[])
    parser.add_argument("--every", type=int, default=25, help="test every Nth clip")
    parser.add_argument("--hidden", choices=SPANS, default=SPANS[:1], nargs="+")
    options = parser.parse_args()
    spans = options.hidden
    pairs = {path for path in options.takes if path.suffix == ".npz"}
    tests = {path: list(recordings_in(path)) for path in options.takes}
    teachers = [one for path in options.train for one in recordings_in(path)]
    teachers += [one for path in pairs for one in tests[path]]
    modes = ("unseen",) if spans == SPANS[:1] else get_args(Mode)
    lessons = read_lessons(teachers, modes)
    groups: dict[str, list[NamedTake]] = {}
    for path, recordings in tests.items():
        for one in recordings:
            groups.setdefault(one.person if path in pairs else "", []).append(one)
    rows = []
    for person, recordings in groups.items():
        others = (one for one in lessons if one.person != person)
        with workers() as pool:
            prior = train_prior(joined(others), pool)
        plain, trained = (
            with_prior(Cleaner(), CleanConfig(), each)
            for each in (MotionPrior({}), prior)
        )
        step = options.every if person else 1
        takes = [one.take.at(slice(_FRAMES)) for one in recordings[::step]]
        found = np.array(
            [
                [row for span in spans for row in errors(take, span, plain, trained)]
                for take in takes
            ]
        )
        shown = found.mean(axis=0).round(1).tolist()
        out.print(f"{person or 'takes'} {len(takes)} {shown}", soft_wrap=True)
        rows.append(found.mean(axis=0))
    lines = product(spans, (*LIMBS, "a foot stands"))
    for (span, limb), figures in zip(lines, np.mean(rows, axis=0), strict=True):
        text = "simple guess, without networks, with, cm:"
        if limb not in LIMBS:
            text = "as seen, without networks, with, %:"
        out.print(span, limb, text, figures.round(1).tolist(), soft_wrap=True)


if __name__ == "__main__":
    main()
