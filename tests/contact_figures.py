"""How often contacts agree with the mocap, and how far off the speed of the hips is.

Reads pairs, and mocap that a virtual Kinect sees. In the mocap, a foot is planted while
its ankle or its toes are slower than 0.4 m/s and lower than 8 cm. Prints for each
person the share of feet [%] whose contact is wrong if both always stand, in clips, and
live with the segment lengths of the clip. Then it prints, where both hips are tracked,
the error of the velocity of their middle [cm/s]: raw, smoothed alone, in clips, live.

    python tests/contact_figures.py ../shared/data/mocap/cmu/{08_01,12_02,35_01}.bvh.gz
"""

from __future__ import annotations

import argparse
from itertools import chain, groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner
from kinefilter.characters import Body, State, Take
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.simulation import recorded_pairs
from kinefilter.pipeline.lab.stance_lessons import planted
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.pipeline.target.smooth import smooth_by_speed, travel_of

_SLOW, _LOW = 0.4, 0.08  # m/s, m
_EVERY = 9  # clips of pairs

Array, Flags = NDArray[np.float64], NDArray[np.bool_]


def followed(take: Take, body: Body) -> tuple[Array, Flags]:
    """Return joints [m] and planted feet of the frames of a take, live."""
    cleaner = Cleaner()
    cleaner.start(body)
    frames = zip(take.positions, take.time, take.state, strict=True)
    drafts = [cleaner.step(p, float(s), state) for p, s, state in frames]
    joints = np.array([draft.positions for draft in drafts])
    return joints, np.array([draft.stands for draft in drafts])


def smoothed(take: Take) -> Array:
    """Return joints [m] that are smoothed as clips are; frames without hips are NaN."""
    joints = np.full_like(take.positions, np.nan)
    seen, hips = np.flatnonzero(hips_seen(take)), list(take.skeleton.hips)
    time, path = take.time[seen], take.positions[seen]
    travel = travel_of(time, path, take.skeleton)[:, hips]
    joints[seen[:, None], hips] = smooth_by_speed(
        time,
        path[:, hips],
        np.ones((len(path), 2)),
        cutoff=CleanConfig().cutoff,
        travel=travel,
    )
    return joints


def hips_seen(take: Take) -> Flags:
    """Return the frames in which both hips are tracked, (T,)."""
    tracked = take.state[:, take.skeleton.hips] == State.TRACKED
    places = np.isfinite(take.positions[:, take.skeleton.hips]).all(axis=2)
    return np.asarray((tracked & places).all(axis=1))


def compared(pair: PairedTake) -> tuple[Array, Array]:
    """Return wrong contacts, (3, N), and errors of speed [m/s], (4, M), of a take."""
    take, clip = pair.take, Cleaner().clean(pair.take).clip
    frames = np.abs(take.time[:, None] - clip.time).argmin(axis=0)
    take, truth = take.at(frames), pair.truth[frames]
    true, known = planted(take.time, truth, take.skeleton, _SLOW, _LOW)
    joints, stands = followed(take, clip.body)
    guesses = np.ones_like(true), planted_feet(clip.contacts), stands
    wrong = np.array([guess != true for guess in guesses])[:, known]
    seen, measure = hips_seen(take), Accuracy(take.skeleton)
    ways = take.positions, smoothed(take), clip.positions, joints
    errors = [measure.hips(take.time, positions, truth) for positions in ways]
    return wrong, np.array(errors)[:, seen[1:] & seen[:-1]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    files = sorted(parser.parse_args().files)
    pairs = chain.from_iterable(recorded_pairs(file, _EVERY) for file in files)
    found = ((pair.subject, *compared(pair)) for pair in pairs)
    out.print("person, feet, always, clip, live; hips raw, smoothed, clip, live")
    for person, group in groupby(found, key=lambda one: one[0]):
        _, wrong, errors = zip(*group, strict=True)
        contacts, hips = (np.concatenate(x, axis=1) for x in (wrong, errors))
        means = [*contacts.mean(axis=1), *np.nanmean(hips, axis=1)]
        out.print(
            f"{person:4s} {contacts.shape[1]:6d}", *(f"{100 * m:5.1f}" for m in means)
        )


if __name__ == "__main__":
    main()
