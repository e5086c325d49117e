"""How far legs that are below the sensor's view are from where they are.

``python tests/view_edge_figures.py TAKES... --train RECORDINGS...`` raises the lower
edge of the view in recorded walks until ankles are below it in a quarter and in half of
the frames. It compares the hidden joints with those of the take cleaned with nothing
hidden, relative to the hips [cm], in the mean over people, who are what files are named
after: held as they were last seen, in clips, and live.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner, read_take
from kinefilter.characters import State, Take
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.limb_lessons import (
    joined,
    read_lessons,
    train_prior,
    with_prior,
)
from kinefilter.pipeline.lab.recorded_acts import recordings_in
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import Mode
from kinefilter.pipeline.workers import workers

Array = NDArray[np.float64]
_SHARES = (25.0, 50.0)  # % of frames with an ankle below the edge
_FRAMES = 900  # of each take
_JOINTS = ("Knee", "Ankle")


def below(take: Take, share: float) -> Take:
    """Return a take without what is below the edge of the view."""
    angle = np.arctan2(take.positions[..., 1], take.positions[..., 2])
    ankles = angle[:, list(take.skeleton.sides("Ankle"))].min(axis=1)
    gone = angle < np.nanpercentile(ankles, share)
    state = np.where(gone, State.NOT_TRACKED, take.state).astype(np.uint8)
    positions = np.where(gone[..., None], np.nan, take.positions)
    return replace(take, positions=positions, state=state)


def followed(take: Take, cleaner: Cleaner) -> Array:
    cleaner.start(*cleaner.measure(take))
    frames = zip(take.positions, take.time, take.state, strict=True)
    return np.array(
        [cleaner.step(p, float(s), state).positions for p, s, state in frames]
    )


def errors(file: Path, prior: MotionPrior) -> tuple[str, Array]:
    """Return the person of a take; sums of errors [cm] and frames, (joints, 4)."""
    take = read_take(file)
    take = take.at(np.flatnonzero(distinct_stamps(take.time))[:_FRAMES])
    config, skeleton = CleanConfig(tilt=0.0), take.skeleton
    cleaner, sums = with_prior(Cleaner(config), config, prior), np.zeros((2, 4))

    def away(motion: Array) -> Array:
        return motion - motion[:, skeleton.hips].mean(axis=1, keepdims=True)

    ways = (
        lambda one: cleaner.clean(one).clip.positions,
        lambda one: followed(one, cleaner),
    )
    for share in _SHARES:
        cut = below(take, share)
        gone = np.isnan(cut.positions[..., 0])
        gone &= ~gone[:, list(skeleton.hips)].any(axis=1)[:, None]
        whole = [away(way(take)) for way in ways]
        found = [away(way(cut)) for way in ways]
        for row, joint in enumerate(_JOINTS):
            for j in skeleton.sides(joint):
                frames = np.flatnonzero(gone[:, j])
                seen = np.flatnonzero(~gone[:, j])
                last = seen[np.maximum(np.searchsorted(seen, frames) - 1, 0)]
                pairs = [(whole[0][last, j], whole[0][frames, j])]
                pairs += [
                    (f[frames, j], w[frames, j])
                    for f, w in zip(found, whole, strict=True)
                ]
                cm = [100.0 * np.linalg.norm(a - b, axis=1).sum() for a, b in pairs]
                sums[row] += [*cm, len(frames)]
    return file.name.partition("_")[0], sums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("takes", type=Path, nargs="+")
    parser.add_argument("--train", type=Path, nargs="+", required=True)
    args, people = (
        parser.parse_args(),
        defaultdict[str, Array](lambda: np.zeros((2, 4))),
    )
    teachers = (one for path in args.train for one in recordings_in(path))
    lessons = joined(read_lessons(teachers, get_args(Mode)))
    with workers() as pool:
        prior = train_prior(lessons, pool)
        for person, sums in pool.map(partial(errors, prior=prior), sorted(args.takes)):
            people[person] += sums
    means = np.mean([s[:, :3] / s[:, 3:] for s in people.values()], axis=0)
    for joint, row, count in zip(
        _JOINTS, means, sum(people.values())[:, 3], strict=True
    ):
        out.print(f"{joint} {count:.0f} held, clip, live:", row.round(1).tolist())


if __name__ == "__main__":
    main()
