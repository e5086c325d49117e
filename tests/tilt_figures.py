"""How upright clips and live motion are where the sensor is not level.

Reads mocap, which a virtual Kinect sees that is tilted by some angles. For each of them
it prints the error of limb joints about the hips [cm], that of their movement [cm], how
far the height of the hips drifts [cm], and how many degrees of the tilt are left, in
the mean over people: of clips as the take is, leveled and with the tilt given, and of
live motion as the take is and leveled.

    python tests/tilt_figures.py ../shared/data/mocap/cmu/{08_01,12_02,35_01}.bvh.gz
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import Take
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.simulation import recorded_pairs
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.workers import workers

_TILTS = (0.0, -4.0, -8.0, 5.0)  # degrees
_WAYS = ("as it is", "leveled", "given", "live as it is", "live leveled")
_BEGINS = 1.0  # s of live motion that do not count

Array = NDArray[np.float64]


def cleaned(take: Take, tilt: float | None) -> tuple[Array, Array, Array]:
    """Return time stamps [s], joints [m] and tilt [degrees] of the frames of a clip."""
    clip = Cleaner(CleanConfig(tilt=tilt)).clean(take).clip
    return clip.time, clip.positions, np.full(len(clip), np.degrees(clip.tilt))


def followed(take: Take, tilt: float | None) -> tuple[Array, Array, Array]:
    """Return the same of live motion, after its beginning."""
    cleaner = Cleaner(CleanConfig(tilt=tilt))
    cleaner.start(*cleaner.measure(take))
    frames = zip(take.positions, take.time, take.state, strict=True)
    drafts = [cleaner.step(p, float(s), state) for p, s, state in frames]
    joints = np.array([draft.positions for draft in drafts])
    tilts = np.degrees([draft.tilt for draft in drafts])
    late = take.time >= take.time[0] + _BEGINS
    return take.time[late], joints[late], tilts[late]


def errors(pair: PairedTake, tilt: float) -> Array:
    """Return the four numbers for each of the ways, (5, 4)."""
    skeleton, measure = pair.take.skeleton, Accuracy(pair.take.skeleton)
    positions = leveled(pair.take.positions, -np.radians(tilt))
    take = replace(pair.take, positions=positions)
    rows = []
    for time, joints, tilts in (
        *(cleaned(take, given) for given in (0.0, None, tilt)),
        *(followed(take, given) for given in (0.0, None)),
    ):
        frames = np.abs(pair.take.time[:, None] - time).argmin(axis=0)
        truth = pair.truth[frames]
        away = measure.distances(joints, truth), measure.varying(joints, truth)
        heights = (joints - truth)[:, skeleton.root, 1]
        cm = [*map(np.nanmean, away), np.nanstd(heights)]
        rows.append([*(100.0 * np.array(cm)), np.abs(tilts - tilt).mean()])
    return np.array(rows)


def figures_of(file: Path) -> tuple[str, Array] | None:
    """Return the person of a recording, and its numbers for each tilt."""
    (pair,) = recorded_pairs(file)
    if pair.take.time[-1] - pair.take.time[0] <= _BEGINS:
        return None
    return pair.subject, np.array([errors(pair, tilt) for tilt in _TILTS])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    people = defaultdict(list)
    with workers() as pool:
        for one in pool.map(figures_of, sorted(parser.parse_args().files)):
            if one is not None:
                people[one[0]].append(one[1])
    means = np.mean([np.mean(found, axis=0) for found in people.values()], axis=0)
    for tilt, rows in zip(_TILTS, means, strict=True):
        for way, row in zip(_WAYS, rows, strict=True):
            out.print(f"{tilt:+3.0f} {way:13s}", *(f"{value:5.1f}" for value in row))


if __name__ == "__main__":
    main()
