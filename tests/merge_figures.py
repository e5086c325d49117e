"""How well two recorded sensors are laid together: README's figures of ``merge``.

    python tests/merge_figures.py ../shared/data/two-kinects [PERSON...]

For each session, of all people or of those named (p10 p12): what the lag found from
motion differs by from the recording computer's ticks, the angle between the sensors,
and how far the limbs of the merged take and of each sensor are apart.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.table import Table

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.formats import read_recording
from kinefilter.pipeline.lab.view_sessions import LIMBS, Session, find_sessions
from kinefilter.pipeline.merge import Merged, merge

_ANGLES = {"parallel": 0.0, "45deg": 45.0, "90deg": 90.0}


def ticked_lag(session: Session) -> float:
    """Return how far the second clock is ahead of the first, by the ticks [s]."""
    rows = session.sync.read_text("utf-8").splitlines()[1:]
    stamps = np.array([row.split(",")[1:3] for row in rows], dtype=float)
    return float(np.mean(stamps[:, 1] - stamps[:, 0]))


def row_of(session: Session, merged: Merged) -> tuple[float, float, float, list[float]]:
    """Return late [s], angle [degrees], path [m], and limbs' distances [cm]."""
    (found,) = merged.alignments
    middle = float(np.mean(merged.takes[0].time))
    late = float(found.clock.at(np.array(middle))) - middle - ticked_lag(session)
    turn = found.placed.turn.apply([0.0, 0.0, 1.0])
    angle = float(np.degrees(np.arctan2(turn[0], turn[2])))
    skeleton, away = merged.take.skeleton, []
    for limb in LIMBS.values():
        joints = [skeleton.index(joint) for joint in limb]
        away += [float(np.nanmedian(of[:, joints])) for of in merged.residuals]
    return late, angle, found.path, [100.0 * apart for apart in away]


def main() -> None:
    """Merge all sessions and print them, and how many are where they should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("people", nargs="*", metavar="PERSON")
    asked = parser.parse_args()
    sides = [f"{limb} {sensor}" for limb in LIMBS for sensor in "AB"]
    table = Table("session", "late, ms", "degrees", "path, m", *sides)
    late, off = [], []
    for session in find_sessions([asked.folder], None):
        if asked.people and session.name.split("_")[0] not in asked.people:
            continue
        recordings = [read_recording(path) for path in (session.first, session.second)]
        try:
            merged = merge(recordings)
        except InputError as refused:
            out.print(f"{session.name}: {refused}")
            continue
        found = row_of(session, merged)
        table.add_row(
            session.name,
            f"{1e3 * found[0]:.0f}",
            f"{found[1]:.1f}",
            f"{found[2]:.2f}",
            *(f"{apart:.1f}" for apart in found[3]),
        )
        if merged.alignments[0].place_is_sure:
            late.append(found[0])
            off.append(found[1] - _ANGLES[session.name.split("_")[1]])
    out.print(table)
    usual = float(np.median(late))
    near = np.abs(np.array(late) - usual) <= 0.02
    out.print(
        f"{len(late)} sessions in which people go to and fro: {near.mean():.0%} of the "
        f"lags within 20 ms of the ticks and {1e3 * usual:.0f} ms by which B's frames "
        f"arrive later, {np.mean(np.abs(late) <= 0.02):.0%} of the ticks alone; "
        f"{np.mean(np.abs(off) <= 3.0):.0%} of the angles within 3 degrees"
    )


if __name__ == "__main__":
    main()
