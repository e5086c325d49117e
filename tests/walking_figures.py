"""How far hidden limbs of people who walk are from where they are.

``python tests/walking_figures.py RECORDINGS... --train OTHERS...`` hides limbs for the
middle 55 % of recordings, and legs below a raised edge of the view, which has an ankle
below it in 40 % of the frames. It compares the hidden joints with those of the
recording cleaned with nothing hidden, relative to the hips or, if these are hidden, in
the room [cm], in the mean over people: held as they were last seen, interpolated,
without networks, in clips, and live.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import Skeleton, State, Take
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.evaluate import followed
from kinefilter.pipeline.lab.limb_guesses import HIDDEN
from kinefilter.pipeline.lab.limb_lessons import (
    joined,
    read_lessons,
    train_prior,
    with_prior,
)
from kinefilter.pipeline.lab.recorded_acts import NamedTake, recordings_in
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import Mode
from kinefilter.pipeline.workers import workers
from kinefilter.retarget import HeadingFrame, find_yaw

Array, Flags = NDArray[np.float64], NDArray[np.bool_]
_EDGE = "below the view"
_HIPS = ("HipCenter", "SpineBase", "HipLeft", "HipRight")
_IN_ROOM = {"hips": _HIPS, "hips and legs": (*_HIPS, *HIDDEN["legs"])}
_WAYS = ("right-arm", "arms", "left-leg", "shins", "legs", _EDGE, *_IN_ROOM)
_FRAMES = 600  # of each recording
_CONFIG = CleanConfig(tilt=0.0, physics=False)


def hidden(take: Take, way: str) -> Flags:
    """Return which joints are hidden, (T, J)."""
    flags = np.zeros(take.positions.shape[:2], dtype=np.bool_)
    if way == _EDGE:
        if ".bvh" in Path(take.source).suffixes:
            return flags  # mocap has no view
        angle = np.arctan2(take.positions[..., 1], take.positions[..., 2])
        ankles = angle[:, list(take.skeleton.sides("Ankle"))].min(axis=1)
        return np.asarray(angle < np.nanpercentile(ankles, 40.0))
    middle = slice(round(0.225 * len(flags)), round(0.775 * len(flags)))
    for j in (HIDDEN | _IN_ROOM)[way]:
        if j in take.skeleton.joints:
            flags[middle, take.skeleton.index(j)] = True
    return flags


def from_hips(motion: Array, skeleton: Skeleton) -> Array:
    return motion - motion[:, skeleton.hips].mean(axis=1, keepdims=True)


def simple(motion: Array, gone: Flags, skeleton: Skeleton) -> Iterator[Array]:
    """Yield a motion whose hidden joints are held, and interpolated.

    That is in the heading frame or, with a hidden root, in the room.
    """
    moves = float(not gone[:, skeleton.root].any())
    roots = moves * motion[:, skeleton.root]
    heading = HeadingFrame(roots, moves * find_yaw(motion, skeleton))
    placed, frames = heading.remove(motion), np.arange(len(gone))
    for hold in (True, False):
        found = placed.copy()
        for j in np.flatnonzero(gone.any(axis=0)):
            seen = np.flatnonzero(~gone[:, j])
            at = np.searchsorted(seen, frames, "right") - 1 if hold else frames
            times = np.arange(len(seen)) if hold else seen
            for axis in range(3):
                found[:, j, axis] = np.interp(at, times, placed[seen, j, axis])
        yield heading.restore(found)


def errors(recording: NamedTake, prior: MotionPrior) -> tuple[str, Array]:
    """Return the person; sums of the five errors [cm], and joints, for each way."""
    take, skeleton = recording.take, recording.take.skeleton
    take = take.at(np.flatnonzero(distinct_stamps(take.time))[:_FRAMES])
    plain, trained = (
        with_prior(Cleaner(_CONFIG), _CONFIG, each) for each in (MotionPrior({}), prior)
    )
    clip, live = trained.clean(take).clip.positions, followed(trained, take, take)
    sums = np.zeros((len(_WAYS), 6))
    parts = ("Elbow", "Wrist", "Hip", "Knee", "Ankle")
    scored = [j.startswith(parts) for j in skeleton.joints]
    for row, way in zip(sums, _WAYS, strict=True):
        flags = hidden(take, way)
        state = np.where(flags, State.NOT_TRACKED, take.state).astype(np.uint8)
        positions = np.where(flags[..., None], np.nan, take.positions)
        blind = replace(take, positions=positions, state=state)
        there = ~flags[:, list(skeleton.hips)].any(axis=1)
        counted = flags & scored & (there | (way in _IN_ROOM))[:, None]
        pairs = (
            *((motion, clip) for motion in simple(clip, flags, skeleton)),
            (plain.clean(blind).clip.positions, clip),
            (trained.clean(blind).clip.positions, clip),
            (followed(trained, blind, blind), live),
        )
        for k, motions in enumerate(pairs):
            one, other = motions
            if way not in _IN_ROOM:
                one, other = (from_hips(motion, skeleton) for motion in motions)
            row[k] = 100.0 * np.linalg.norm(one - other, axis=2)[counted].sum()
        row[-1] = counted.sum()
    return recording.name.partition("_")[0], sums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--train", type=Path, nargs="+", required=True)
    args, people = parser.parse_args(), defaultdict[str, list[Array]](list)
    teachers = (one for path in args.train for one in recordings_in(path))
    lessons = joined(read_lessons(teachers, get_args(Mode)))
    tests = [one for path in sorted(args.recordings) for one in recordings_in(path)]
    with workers() as pool:
        prior = train_prior(lessons, pool)
        for person, sums in pool.map(partial(errors, prior=prior), tests):
            people[person].append(sums)
    totals = np.array([np.sum(each, axis=0) for each in people.values()])
    with np.errstate(invalid="ignore"):
        means = np.nanmean(totals[..., :-1] / totals[..., -1:], axis=0)
    for way, row in zip(_WAYS, means, strict=True):
        columns = "held, interpolated, without networks, clips, live, cm:"
        out.print(f"{way}: {columns}", row.round(1), soft_wrap=True)


if __name__ == "__main__":
    main()
