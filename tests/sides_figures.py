"""People whom a sensor sees from behind, who walk backward if it has them face it.

    python tests/sides_figures.py ../shared/data/two-kinects [PERSON...]

For the side sensor of each session in which somebody walks about, of all people or of
those named (p10 p12): the share of the walking frames in which people go backward, as
recorded, with sides swapped back, and as live motion has them. Where the person faces
the front sensor, that one tells the sides of arms and of legs: the share that is wrong,
and the limbs' distances from that sensor's, likewise. Of takes of standing and steps,
and of clips in ``--pairs``, how many have sides swapped at all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.table import Table

from kinefilter.characters import Take
from kinefilter.characters.arrays import Flags
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.failures.sides import LiveSides, root_velocity, swapped_frames
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.lab.view_sessions import (
    Session,
    find_sessions,
    read_views,
    toward,
    view_pairs,
)
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.retarget import find_yaw

_WALKING = 0.3  # m/s
_BACKWARD = np.radians(120.0)  # between course and heading
_CLEARLY = 3.0  # cm by which limbs of the wrong side are farther away


def swapped_live(take: Take) -> Flags:
    """Return the frames (T,) in which live motion swaps sides back."""
    sides = LiveSides(take.skeleton)
    frames = zip(take.positions, take.state, take.time, strict=True)
    return np.array([sides.swapped(p, s, float(t)) for p, s, t in frames])


def backward(*takes: Take) -> list[float]:
    """Return the shares of walking frames [%] in which people go backward."""
    take = takes[0]
    velocity = root_velocity(take.time, take.positions[:, take.skeleton.root])
    course = np.arctan2(velocity[:, 0], velocity[:, 2])
    walks = np.hypot(velocity[:, 0], velocity[:, 2]) > _WALKING
    shares = []
    for one in takes:
        yaw = find_yaw(one.positions, one.skeleton)
        off = np.abs(np.angle(np.exp(1j * (course - yaw))))
        shares.append(float((off[walks] > _BACKWARD).mean() * 100.0))
    return shares


def figures_of(session: Session) -> list[float]:
    """Return a session's figures, in the order of the table."""
    views = read_views(session)
    (pair,) = view_pairs([session])
    take, mended, rows = views.side, pair.take, views.frames[toward(views)]
    live = take.swapped(swapped_live(take))
    mirror, truth = take.skeleton.mirror, pair.truth[rows]
    away = []
    for names in (("Elbow", "Wrist"), ("Knee", "Ankle")):
        joints = [joint for name in names for joint in take.skeleton.sides(name)]
        seen = (
            take.positions[rows][:, joints],
            mended.positions[rows][:, joints],
            live.positions[rows][:, joints],
            take.positions[rows][:, mirror[joints]],
        )
        parts = [np.linalg.norm(one - truth[:, joints], axis=2) for one in seen]
        away.append(np.stack(parts).mean(axis=2) * 100.0)
    distances = np.concatenate(away, axis=1)
    distances = distances[:, ~np.isnan(distances).any(axis=0)]
    wrong = distances[:3] > distances.min(axis=0) + _CLEARLY
    shares = wrong.mean(axis=1) * 100.0
    return [*backward(take, mended, live), *shares, *distances[:3].mean(axis=1)]


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
    for heading in ("sessions", "backward, %", "wrong sides, %", "limbs, cm"):
        table.add_column(heading, justify="right")
    for angle in ("parallel", "45deg", "90deg"):
        walks = [s for s in sessions if s.name.endswith(f"{angle}_walk")]
        if walks:
            means = np.mean([figures_of(session) for session in walks], axis=0)
            cells = [", ".join(f"{v:.1f}" for v in row) for row in means.reshape(-1, 3)]
            table.add_row(angle, str(len(walks)), *cells)
    out.print(table)
    others = [s for s in sessions if s.name.split("_")[-1] in ("stand", "steps")]
    takes = [read_recording(p).take() for s in others for p in (s.first, s.second)]
    takes = [take.at(np.unique(take.time, return_index=True)[1]) for take in takes]
    clips = [pair.take for path in given.pairs for pair in read_pairs(path)]
    for some, name in ((takes, "takes of standing and steps"), (clips, "clips")):
        swapped = sum(bool(swapped_frames(take).any()) for take in some)
        live = sum(bool(swapped_live(take).any()) for take in some)
        out.print(f"sides swapped in {swapped}, live {live}, of {len(some)} {name}")


if __name__ == "__main__":
    main()
