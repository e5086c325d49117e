"""Recorded takes, and people seen by Kinect and marker mocap, where they are there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import Progress, silent

from .takes import people_of

RECORDINGS = Path("../shared/data")
"""Where recordings are looked for; they are not part of kinefilter."""

_PEOPLE = 4  # who stand in for recorded people
_MOVEMENTS = ("squat", "side_lunge", "raise_arms")  # what they do, as rehabilitation
_REPETITIONS = 10  # as many as people were recorded with


def recordings_folder(data: Path | None) -> Path | None:
    """Return the folder of recordings, or None where there is none.

    Args:
        data: What was asked for; None: the usual place, if it is there.

    Raises:
        InputError: A folder was asked for and is not there.
    """
    if data is None:
        return RECORDINGS if RECORDINGS.is_dir() else None
    if not data.is_dir():
        raise InputError(
            f"{data}: there is no such folder; give that of the recordings"
        )
    return data


def recorded_takes(data: Path | None) -> list[Path]:
    """Return the recorded takes, in order; none without recordings."""
    if data is None:
        return []
    folder = data / "takes"
    return sorted([*folder.glob("*/*.csv"), *folder.glob("*/*.csv.gz")])


def people(data: Path | None) -> list[str]:
    """Return who was recorded beside marker mocap, or who stands in for them."""
    if data is None:
        return [f"simulated {k + 1}" for k in range(_PEOPLE)]
    found = sorted(path.stem for path in (data / "ui-prmd").glob("s*.npz"))
    if not found:
        raise InputError(f"{data}: no ui-prmd/s*.npz in this folder of recordings")
    return found


def person(
    data: Path | None,
    name: str,
    seed: int,
    movements: int,
    progress: Progress = silent,
) -> list[PairedTake]:
    """Return the clips of somebody and their truth.

    Args:
        data: Folder of recordings; None: simulated.
        name: Out of ``people``.
        seed: Draws simulated people, performances and the sensor's errors.
        movements: How many of the movements, from the first.
        progress: Wraps the loop over simulated clips, for a progress bar.
    """
    if data is None:
        return _simulated(people(None).index(name), seed, movements, progress)
    clips = read_pairs(data / "ui-prmd" / f"{name}.npz")
    known = sorted({pair.clip[:3] for pair in clips})[:movements]
    return [pair for pair in clips if pair.clip[:3] in known]


def _simulated(
    k: int, seed: int, movements: int, progress: Progress
) -> list[PairedTake]:
    """Return clips named as the recorded ones are."""
    who, chosen = people_of(seed) + k, _MOVEMENTS[:movements]
    pairs = []
    for n in progress("record", len(chosen) * _REPETITIONS):
        m, e = divmod(n, _REPETITIONS)
        pair = simulate("basic", chosen[m], seed=who + 100 * n, person=who)
        clip = f"m{m + 1:02d}_s{k + 1:02d}_e{e + 1:02d}"
        pairs.append(replace(pair, subject=f"simulated {k + 1}", clip=clip))
    return pairs
