"""What was found when takes were paired: figures, a table, a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from kinefilter.pipeline.formats.files import atomic_path
from kinefilter.pipeline.reliability import column_medians

from .pairing import Pairing
from .studies.output import draw
from .studies.study import Panel, Series, Study


def figures_of(pairing: Pairing) -> dict[str, Any]:
    """Return what was found, ready for JSON."""
    joints, cm = pairing.pair.take.skeleton.joints, 100.0
    return {
        "clip": pairing.pair.clip,
        "frames": len(pairing.pair.take),
        "lag_s": pairing.clock.lag,
        "drift_s_per_s": pairing.clock.drift,
        "rotation_wxyz": pairing.placed.turn.as_quat(scalar_first=True).tolist(),
        "translation_m": pairing.placed.shift.tolist(),
        "explained": pairing.explained,
        "away_cm": dict(zip(joints, cm * column_medians(pairing.away), strict=True)),
        "varying_cm": dict(
            zip(joints, cm * column_medians(pairing.varying), strict=True)
        ),
        "notes": list(pairing.notes),
    }


def as_table(pairings: Sequence[Pairing]) -> Table:
    """Return what was found, for a terminal."""
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
        "lag: what the mocap's clock shows when the take begins; explained: share of "
        "the take's movement; cm: median distance of joints from the mocap"
    )
    return table


def draw_residuals(pairings: Sequence[Pairing], path: Path) -> None:
    """Write a picture (PNG) of how far each joint is from the mocap.

    Raises:
        InputError: The file cannot be written, or matplotlib is not installed.
    """
    skeleton = pairings[0].pair.take.skeleton
    rows = []
    for label, name in (("median", "away"), ("median, mean difference off", "varying")):
        values = np.concatenate([getattr(p, name) for p in pairings])
        rows.append((label, 100.0 * column_medians(values)))
    known = ~np.isnan(rows[0][1])
    joints = [joint for joint, seen in zip(skeleton.joints, known, strict=True) if seen]
    groups = [Series(label, joints, v[known].tolist(), "bars") for label, v in rows]
    title = f"{pairings[0].pair.subject}: Kinect beside mocap, {len(pairings)} takes"
    panels = [Panel("", "distance, cm", groups)]
    study = Study(title, (), (), panels)
    with atomic_path(path) as temporary:
        draw(study, temporary)
