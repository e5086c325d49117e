"""How often contacts agree with the mocap, and how far off the speed of joints is.

Reads pairs, and mocap that a virtual Kinect sees. In the mocap, a foot is planted while
its ankle or its toes are slower than 0.4 m/s and lower than 8 cm. Prints for each
person the share of feet [%] whose contact is wrong if both always stand, in clips, and
live with the segment lengths of the clip. Then it prints the error of velocities
[cm/s], raw, smoothed alone, in clips and live: that of the middle of the hips, and of
other joints relative to it, where the sensor tracks them.

    python tests/contact_figures.py ../shared/data/mocap/cmu/{08_01,12_02,35_01}.bvh.gz
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import chain, groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import Body, State, Take
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.simulation import recorded_pairs
from kinefilter.pipeline.lab.stance_lessons import planted
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.pipeline.target.smooth import (
    smooth_by_speed,
    travel_of,
    weights_of_outliers,
)

_SLOW, _LOW = 0.4, 0.08  # m/s, m
_EVERY = 9  # clips of pairs
PARTS = ("Hip", "Head", "Shoulder", "Elbow", "Wrist", "Knee", "Ankle")

Array, Flags = NDArray[np.float64], NDArray[np.bool_]


def followed(take: Take, body: Body) -> tuple[Array, Flags]:
    """Return joints [m] and planted feet of the frames of a take, live."""
    cleaner = Cleaner()
    cleaner.start(body)
    frames = zip(take.positions, take.time, take.state, strict=True)
    drafts = [cleaner.step(p, float(s), state) for p, s, state in frames]
    joints = np.array([draft.positions for draft in drafts])
    return joints, np.array([draft.stands for draft in drafts])


def tracked(take: Take, joints: Sequence[int]) -> Flags:
    """Return the frames in which joints are tracked, (T,)."""
    placed = np.isfinite(take.positions[:, joints]).all(axis=2)
    return np.asarray((placed & (take.state[:, joints] == State.TRACKED)).all(axis=1))


def smoothed(take: Take) -> Array:
    """Return tracked joints [m], smoothed as clips are, and NaN elsewhere."""
    joints, cutoff = np.full_like(take.positions, np.nan), CleanConfig().cutoff
    hips = take.skeleton.hips.tolist()
    for j in range(len(take.skeleton)):
        seen = tracked(take, [j, *hips])
        time, paths = take.time[seen], take.positions[seen]
        if len(time) > 1:
            travel = travel_of(time, paths, take.skeleton)[:, [j]]
            path = paths[:, [j]]
            weights = weights_of_outliers(time, path)
            path = smooth_by_speed(time, path, weights, cutoff=cutoff, travel=travel)
            joints[seen, j] = path[:, 0]
    return joints


def speed_errors(take: Take, joints: Array, truth: Array) -> dict[str, Array]:
    """Return the errors of velocity [m/s] by part of the body, each (N,)."""
    skeleton, steps = take.skeleton, np.diff(take.time)[:, None, None]
    hips = skeleton.hips.tolist()
    off = joints - truth
    middle = off[:, hips].mean(axis=1, keepdims=True)
    found = {}
    for part in PARTS:
        some = [j for j, kind in enumerate(skeleton.kinds) if kind == part]
        moved = middle if part == "Hip" else off[:, some] - middle
        seen = tracked(take, [*some, *hips])
        speed = np.linalg.norm(np.diff(moved, axis=0) / steps, axis=2)
        found[part] = speed[seen[1:] & seen[:-1]].mean(axis=1)
    return found


def compared(pair: PairedTake) -> tuple[Array, list[dict[str, Array]]]:
    """Return wrong contacts, (3, N), and errors of speed [m/s] of the four ways."""
    take, clip = pair.take, Cleaner().clean(pair.take).clip
    frames = np.abs(take.time[:, None] - clip.time).argmin(axis=0)
    take, truth = take.at(frames), pair.truth[frames]
    true, known = planted(take.time, truth, take.skeleton, _SLOW, _LOW)
    joints, stands = followed(take, clip.body)
    guesses = np.ones_like(true), planted_feet(clip.contacts), stands
    wrong = np.array([guess != true for guess in guesses])[:, known]
    ways = take.positions, smoothed(take), clip.positions, joints
    return wrong, [speed_errors(take, positions, truth) for positions in ways]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    files = sorted(parser.parse_args().files)
    pairs = chain.from_iterable(recorded_pairs(file, _EVERY) for file in files)
    found = ((pair.subject, *compared(pair)) for pair in pairs)
    out.print("person, feet, contacts always, clip, live; then by part of the body")
    out.print("errors of speed raw, smoothed alone, clip, live")
    for person, group in groupby(found, key=lambda one: one[0]):
        _, wrong, errors = zip(*group, strict=True)
        contacts = np.concatenate(wrong, axis=1)
        shares = (f"{100 * m:5.1f}" for m in contacts.mean(axis=1))
        out.print(f"{person:4s} {contacts.shape[1]:6d}", *shares)
        for part in PARTS:
            means = (
                np.nanmean(np.concatenate([take[way][part] for take in errors]))
                for way in range(4)
            )
            out.print(f"     {part:8s}", *(f"{100 * m:5.1f}" for m in means))


if __name__ == "__main__":
    main()
