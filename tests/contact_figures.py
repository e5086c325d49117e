"""How often contacts of clips agree with the mocap.

Reads pairs, and mocap that a virtual Kinect sees. In the mocap, a foot is planted while
its ankle or its toes are slower than 0.4 m/s and lower than 8 cm. Prints for each
person the share of feet [%] whose contact is wrong if both always stand, in clips, and
live with the segment lengths of the clip.

    python tests/contact_figures.py ../shared/data/mocap/cmu/{08_01,12_02,35_01}.bvh.gz
"""

from __future__ import annotations

import argparse
from itertools import chain, groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import Avatar, Cleaner
from kinefilter.characters import Take
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.lab.simulation import recorded_pairs
from kinefilter.pipeline.lab.stance_lessons import planted
from kinefilter.pipeline.target.feet import planted_feet

_SLOW, _LOW = 0.4, 0.08  # m/s, m
_EVERY = 9  # clips of pairs

Flags = NDArray[np.bool_]


def live_contacts(take: Take, avatar: Avatar) -> Flags:
    """Return whether each foot is planted in each frame that an avatar follows."""
    frames = zip(take.time, take.positions, take.state, strict=True)
    return np.array([avatar.step(p, s, state).stands for s, p, state in frames])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    files = sorted(parser.parse_args().files)
    found = []
    pairs = chain.from_iterable(recorded_pairs(file, _EVERY) for file in files)
    for pair in pairs:
        take, clip = pair.take, Cleaner().clean(pair.take).clip
        true, known = planted(take.time, pair.truth, take.skeleton, _SLOW, _LOW)
        frames = np.abs(take.time[:, None] - clip.time).argmin(axis=0)
        live = live_contacts(take, Avatar(clip.body))
        guesses = np.ones_like(true)[frames], planted_feet(clip.contacts), live[frames]
        wrong = np.array([guess != true[frames] for guess in guesses])
        found.append((pair.subject, wrong[:, known[frames]]))
    out.print("person, feet, always, clip, live")
    for person, group in groupby(found, key=lambda one: one[0]):
        wrong = np.concatenate([values for _, values in group], axis=1)
        means = (f"{value:5.1f}" for value in 100.0 * wrong.mean(axis=1))
        out.print(f"{person:4s} {wrong.shape[1]:6d}", *means)


if __name__ == "__main__":
    main()
