"""People whom a sensor sees from behind, who walk backward if it has them face it.

    python tests/sides_figures.py ../shared/data/two-kinects [PERSON...]

For both sensors of each session in which somebody walks about, of all people or of
those named (p10 p12): the share of the frames in which people go backward, before and
after sides are swapped back; and how far limbs are from the two sensors' merged take,
relative to the root, cleaned without correction, with sides as recorded and swapped
back. Of takes of standing and steps, and of clips in ``--pairs``, how many have sides
swapped at all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.table import Table

from kinefilter.characters import Clip, InputError, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.cleaner import Cleaner
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.failures.sides import root_velocity, swapped_frames
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.lab.two_views import LIMBS, Session, find_sessions
from kinefilter.pipeline.merge import merge
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.retarget import find_yaw

_WALKING = 0.3  # m/s
_BACKWARD = np.radians(120.0)  # between course and heading


def backward(take: Take, swapped: Flags) -> tuple[float, float]:
    """Return the shares of walking frames in which people go backward, and mended."""
    velocity = root_velocity(take.time, take.positions[:, take.skeleton.root])
    course = np.arctan2(velocity[:, 0], velocity[:, 2])
    yaw = find_yaw(take.positions, np.ones(take.state.shape), take.skeleton)
    off = np.abs(np.angle(np.exp(1j * (course - yaw))))
    mended = np.where(swapped, np.pi - off, off)
    walks = np.hypot(velocity[:, 0], velocity[:, 2]) > _WALKING
    return float((off[walks] > _BACKWARD).mean()), float(
        (mended[walks] > _BACKWARD).mean()
    )


def apart(clip: Clip, merged: Take) -> float:
    """Return the mean distance of limb joints from the merged take's [cm]."""
    rows = np.searchsorted(clip.time, merged.time).clip(max=len(clip) - 1)
    same = np.abs(clip.time[rows] - merged.time) < 2e-3
    joints = [merged.skeleton.index(name) for limb in LIMBS.values() for name in limb]
    root = merged.skeleton.root

    def limbs(positions: Array) -> Array:
        return (positions - positions[:, [root]])[same][:, joints]

    if not same.any():
        return float("nan")
    away = limbs(clip.positions[rows]) - limbs(merged.positions)
    return float(np.nanmean(np.linalg.norm(away, axis=2)) * 100.0)


def figures_of(session: Session) -> Array:
    """Return both sensors' figures, shape (2, 4), NaN where they do not merge."""
    rows, paths = [], (session.first, session.second)
    for one, other in (paths, paths[::-1]):
        recordings = [read_recording(path) for path in (one, other)]
        take = recordings[0].take()
        take = take.at(np.unique(take.time, return_index=True)[1])
        distances = [np.nan, np.nan]
        try:
            merged = merge(recordings).take
        except InputError as error:
            out.print(f"{session.name}: {error}")
        else:
            cleaner = Cleaner(CleanConfig(method="none"))
            for k, one_of in enumerate((cleaner.without("failures"), cleaner)):
                distances[k] = apart(one_of.clean(take).clip, merged)
        rows.append([*backward(take, swapped_frames(take)[:, 0]), *distances])
    return np.array(rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("people", nargs="*")
    parser.add_argument("--pairs", type=Path, nargs="*", default=[])
    given = parser.parse_args()
    sessions = [
        session
        for session in find_sessions([given.folder], None)
        if not given.people or session.person in given.people
    ]
    table = Table("sensors", title="people who walk about, seen by one sensor")
    for heading in ("sessions", "backward, %", "mended, %", "apart, cm", "mended, cm"):
        table.add_column(heading, justify="right")
    for angle in ("parallel", "45deg", "90deg"):
        walks = [s for s in sessions if s.name.endswith(f"{angle}_walk")]
        if walks:
            rows = np.concatenate([figures_of(session) for session in walks])
            means = np.nanmean(rows, axis=0) * [100.0, 100.0, 1.0, 1.0]
            cells = [f"{mean:.1f}" for mean in means]
            table.add_row(angle, str(len(walks)), *cells)
    out.print(table)
    others = [s for s in sessions if s.name.split("_")[-1] in ("stand", "steps")]
    takes = [read_recording(p).take() for s in others for p in (s.first, s.second)]
    takes = [take.at(np.unique(take.time, return_index=True)[1]) for take in takes]
    clips = [pair.take for path in given.pairs for pair in read_pairs(path)]
    for some, name in ((takes, "takes of standing and steps"), (clips, "clips")):
        swapped = sum(bool(swapped_frames(take).any()) for take in some)
        out.print(f"sides swapped in {swapped} of {len(some)} {name}")


if __name__ == "__main__":
    main()
