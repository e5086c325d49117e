"""How near ``clean`` comes to marker mocap, with no model trained on recordings.

The virtual Kinect that the embedded offsets were learned from was fitted to some of
these people, and set by hand against others (``tests/calibrate_kinect.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import clean
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.accuracy import Accuracy, Tally
from kinefilter.pipeline.metrics import jitter
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent

from .recordings import people, person
from .study import Cell, Panel, Series, Study

_PEOPLE = ("s03", "s06", "s07", "s08")  # on whom little was chosen
_EVERY = 5  # clips of a person to one that is cleaned
_CONFIGS = {
    "smoothed": CleanConfig(method="none", physics=False),
    "smoothed, physics": CleanConfig(method="none"),
    "default, no physics": CleanConfig(physics=False),
    "default": CleanConfig(),
}
_NAMES = ("raw", *_CONFIGS, "mocap")


def marker_mocap(
    *,
    seed: int = 0,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Clean every fifth clip of four people and compare it with their marker mocap.

    E is the distance of limb joints, relative to the middle of the hips; E_var the same
    without each joint's constant offset over a clip; both are means over frames and
    joints, then over people. Jitter is the mean over clips, of limb joints. Without
    recordings simulated people and their truth stand in.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        movements: How many of the movements, from the first.
        data: Folder of recordings; None: simulated.
        progress: Wraps the loops, for a progress bar.
    """
    pairs = _clips(data, seed, movements, progress)
    accuracy = Accuracy(pairs[0].take.skeleton)
    tallies = {name: Tally(accuracy) for name in _NAMES}
    jitters: dict[str, list[float]] = {name: [] for name in _NAMES}
    for k in progress("clean", len(pairs)):
        for name, positions in _motions(pairs[k]).items():
            tallies[name].add(pairs[k], positions, 0.0)
            limbs = positions[:, accuracy.limbs]
            jitters[name].append(jitter(pairs[k].take.time, limbs))
    trembling = {name: float(np.mean(values)) for name, values in jitters.items()}
    found = {name: tally.summary() for name, tally in tallies.items()}
    rows: list[tuple[Cell, ...]] = [
        (name, row["E"], row["E_std"], row["E_var"], trembling[name])
        for name, row in found.items()
    ]
    ratio = trembling["default"] / trembling["mocap"]
    rows.append(("default over mocap", None, None, None, ratio))
    return Study(
        name="marker-mocap",
        title=f"{len(pairs)} clips of four people, against their marker mocap",
        columns=("motion", "E_cm", "E_std_cm", "E_var_cm", "jitter_m_per_s3"),
        rows=tuple(rows),
        panels=(
            Panel(
                "motion",
                "error, cm",
                tuple(
                    Series(
                        key, _NAMES[:-1], [found[n][key] for n in _NAMES[:-1]], "bars"
                    )
                    for key in ("E", "E_var")
                ),
            ),
        ),
    )


def _clips(
    data: Path | None, seed: int, movements: int, progress: Progress
) -> list[PairedTake]:
    """Return the clips that are cleaned."""
    names = people(None) if data is None else _PEOPLE
    clips: list[PairedTake] = []
    for name in names:
        own = person(data, name, seed, movements, progress)
        clips += own[::_EVERY]
    return clips


def _motions(pair: PairedTake) -> dict[str, Array]:
    """Return the motions that are compared with the mocap [m], each (T, J, 3)."""
    cleaned = {
        name: clean(pair.take, config).clip.positions
        for name, config in _CONFIGS.items()
    }
    return {"raw": pair.take.positions, **cleaned, "mocap": pair.truth}
