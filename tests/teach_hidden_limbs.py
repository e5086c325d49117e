"""Teach the shipped prior how hidden limbs move, and print what it is worth.

    python tests/teach_hidden_limbs.py pipeline/embedded/hidden_limbs.npz RECORDINGS...

writes the weights of ``reconstruct.prior``; recordings are pairs files, takes, or mocap
in BVH. It then prints, for each person and each third of the movements in the pairs,
the errors of networks trained without them, in percent of the errors without networks.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from kinefilter.characters.rotations import unit
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.lab.limb_lessons import (
    Lessons,
    joined,
    read_lessons,
    train_prior,
)
from kinefilter.pipeline.lab.recorded_acts import recordings_in
from kinefilter.pipeline.reconstruct import MotionPrior
from kinefilter.pipeline.reconstruct.prior import Mode
from kinefilter.pipeline.workers import workers


def relative_errors(prior: MotionPrior, lessons: Lessons) -> dict[str, float]:
    """Return each network's error of directions, in percent of that without it."""
    percent = {}
    for name, rows in lessons.items():
        change = prior.change(name, rows.inputs.astype(float)).reshape(rows.base.shape)
        error, plain = (
            np.linalg.norm(unit(directions) - rows.truth, axis=-1).mean()
            for directions in (rows.base + change, rows.base.astype(float))
        )
        percent[name] = round(float(error / plain * 100), 1)
    return percent


def main(out: Path, files: Sequence[str]) -> None:
    """Train on recordings, write the weights, and print ``relative_errors``."""
    recordings = [r for file in files for r in recordings_in(Path(file))]
    lessons = read_lessons(recordings, get_args(Mode))
    pairs = [Path(file) for file in files if file.endswith(".npz")]
    people = sorted({one.person for file in pairs for one in recordings_in(file)})
    movements = sorted({one.movement for one in lessons if one.person in people})
    thirds = [set(movements[k::3]) for k in range(3)]
    with workers() as pool:
        write_arrays(out, train_prior(joined(lessons), pool).arrays())
        for names in (*({person} for person in people), *thirds):
            left_out = [one for one in lessons if names & {one.person, one.movement}]
            others = [one for one in lessons if not names & {one.person, one.movement}]
            prior = train_prior(joined(others), pool)
            percent = relative_errors(prior, joined(left_out))
            print(", ".join(sorted(names)), percent, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
