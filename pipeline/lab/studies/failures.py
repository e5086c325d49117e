"""Gross failures of the tracker: how many are found, and how many alarms are false."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter1d

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.failures import FailureKind, find_failures
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent

from .recordings import people, person, recorded_takes
from .study import Cell, Panel, Series, Study

_JOINTS = ("Elbow", "Wrist", "Knee", "Ankle")
_FAR = 0.2  # m off the mocap
_LASTING = 9  # frames, 0.3 s, that a joint is far off before its limb counts as lost


def failures(
    *,
    seed: int = 0,
    count: int = 1000,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Look for gross failures in takes that have some, and in takes that have none.

    The latter are clips beside marker mocap in which no elbow, wrist, knee or ankle is
    over 20 cm off for 0.3 s, relative to the middle of the hips. Without recordings
    simulated people stand in, and there are no other takes.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        count: How many takes of a kind, and how many people, at most.
        movements: How many of the movements, from the first.
        data: Folder of recordings; None: simulated.
        progress: Wraps the loops, for a progress bar.
    """
    files = recorded_takes(data)
    failed = [file for file in files if file.stem.endswith("_failure")][:count]
    quick = [file for file in files if file.parent.name == "precog16"][:count]
    lost = [_kinds(read_take(file)) for file in over(failed, "failures", progress)]
    alarms = [_kinds(read_take(file)) for file in over(quick, "kicks", progress)]
    near = [
        _kinds(pair.take)
        for name in over(people(data)[:count], "people", progress)
        for pair in person(data, name, seed, movements)
        if _near(pair)
    ]
    groups = {
        "recorded failures": [bool(kinds) for kinds in lost],
        "recorded failures, by leaps alone": [
            kinds == {FailureKind.LEAPING} for kinds in lost
        ],
        "punches and kicks": [bool(kinds) for kinds in alarms],
        "near the mocap": [bool(kinds) for kinds in near],
    }
    return Study(
        name="failures",
        title="Takes in which a gross failure is found",
        columns=("takes", "count", "found", "found_percent"),
        rows=tuple(_row(name, found) for name, found in groups.items()),
        panels=(_panel(groups),),
    )


def _kinds(take: Take) -> set[FailureKind]:
    return {failure.kind for failure in find_failures(take)}


def _near(pair: PairedTake) -> bool:
    """Tell whether no limb is far from the mocap for long."""
    index = pair.take.skeleton.index
    apart = pair.take.positions - pair.truth
    apart -= apart[:, pair.take.skeleton.hips].mean(axis=1, keepdims=True)
    joints = [index(j + side) for j in _JOINTS for side in ("Left", "Right")]
    off: Array = np.nan_to_num(np.linalg.norm(apart[:, joints], axis=2))
    limbs = off.reshape(len(off), 2, 2, 2).max(axis=2)  # time, arm or leg, joint, side
    return bool(minimum_filter1d(limbs, _LASTING, axis=0).max() < _FAR)


def _row(name: str, found: Sequence[bool]) -> tuple[Cell, ...]:
    if not found:
        return (name, None, None, None)
    return (name, len(found), sum(found), 100.0 * sum(found) / len(found))


def _panel(groups: dict[str, list[bool]]) -> Panel:
    shares = [100.0 * sum(found) / max(len(found), 1) for found in groups.values()]
    names = [name.replace(", ", ",\n") for name in groups]
    return Panel("takes", "found, %", (Series("found", names, shares, "bars"),))
