"""The results of pairing takes with mocap as JSON, a table, and a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from kinefilter.pipeline.formats.files import atomic_path
from kinefilter.pipeline.reliability import column_medians

from .pairing import Pairing
from .studies.study import Panel, Series, Study, draw


def figures_of(pairing: Pairing) -> dict[str, Any]:
    """Return the alignment and residuals of a pair, ready for JSON."""
    joints = pairing.pair.take.skeleton.joints
    away, varying = (
        dict(zip(joints, 100.0 * column_medians(distances), strict=True))
        for distances in (pairing.away, pairing.varying)
    )
    return {
        "clip": pairing.pair.clip,
        "frames": len(pairing.pair.take),
        "lag_s": pairing.clock.lag,
        "drift_s_per_s": pairing.clock.drift,
        "rotation_wxyz": pairing.placed.turn.as_quat(scalar_first=True).tolist(),
        "translation_m": pairing.placed.shift.tolist(),
        "explained": pairing.explained,
        "away_cm": away,
        "varying_cm": varying,
        "notes": list(pairing.notes),
    }


def as_table(pairings: Sequence[Pairing]) -> Table:
    """Return the alignments and residuals of pairs as a table for the terminal."""
    table = Table("clip", title="pairs of Kinect and mocap")
    for heading in ("frames", "lag, s", "drift, ms a min", "explained, %", "cm"):
        table.add_column(heading, justify="right")
    for pairing in pairings:
        drift = pairing.clock.drift
        table.add_row(
            pairing.pair.clip,
            str(len(pairing.pair.take)),
            f"{pairing.clock.lag:.3f}",
            f"{drift * 6e4:.1f}" if drift else "-",
            f"{100 * pairing.explained:.0f}",
            f"{100 * np.nanmedian(pairing.away):.1f}",
        )
    table.caption = (
        "lag: reading of the mocap's clock when the take begins; explained: share of "
        "the take's movement; cm: median distance of joints from the mocap"
    )
    return table


def draw_residuals(pairings: Sequence[Pairing], path: Path) -> None:
    """Plot each joint's median distance from the mocap (PNG), or InputError."""
    skeleton, medians = pairings[0].pair.take.skeleton, []
    for name in ("away", "varying"):
        distances = np.concatenate([getattr(p, name) for p in pairings])
        medians.append(100.0 * column_medians(distances))
    known = np.flatnonzero(~np.isnan(medians[0]))
    joints = [skeleton.joints[j] for j in known]
    labels = "median", "median, mean offset subtracted"
    groups = [
        Series(label, joints, values[known].tolist(), "bars")
        for label, values in zip(labels, medians, strict=True)
    ]
    title = f"{pairings[0].pair.subject}: Kinect beside mocap, {len(pairings)} takes"
    with atomic_path(path) as temporary:
        draw(Study(title, (), (), [Panel("", "distance, cm", groups)]), temporary)
