"""What ``clean`` makes of takes by itself: recorded ones, and one of every motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.cleaner import CleanResult, clean
from kinefilter.pipeline.formats import read_take
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.scenes.library import MOTIONS

from .recordings import recorded_takes
from .study import Cell, Panel, Series, Study

_SEED = 4000  # of the first simulated take; nobody of the database has one as high
_FIGURES: dict[str, Callable[[Array], np.float64]] = {
    "feet slide, mm a frame": np.max,
    "feet over 0.2 m/s, %": np.max,
    "body under the floor, mean, mm": np.max,
    "body under the floor, most, mm": np.max,
    "standing soles float, mm": np.max,
    "jitter, share of raw": np.max,
    "bone-length variation": np.max,
    "amplitude, after over before physics": np.min,
    "peak hand speed, after over before physics": np.min,
    "amplitude, share of raw": np.min,
    "distance from the target, cm": np.max,
    "external force, body weights": np.max,
    "frames outside the database, %": np.max,
    "simulation resets": np.max,
}
"""What is measured of a take, and which end of it is the worse."""


def cleaned_takes(
    *,
    seed: int = 0,
    count: int = 1000,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Clean every recorded take and a simulated one of every motion, with defaults.

    Figures are those of ``clean --json`` after physics: the mean over takes, and the
    worst take. Shares are of the same take before.

    Args:
        seed: Draws simulated people, performances and the sensor's errors.
        count: How many recorded and how many simulated takes at most.
        data: Folder of recordings; None: simulated takes alone.
        progress: Wraps the loops, for a progress bar.
    """
    files, motions = recorded_takes(data)[:count], list(MOTIONS)[:count]
    recorded = over(files, "recorded takes", progress)
    simulated = progress("simulated takes", len(motions))
    groups = {
        "recorded": [_figures(clean(read_take(file))) for file in recorded],
        "simulated": [
            _figures(clean(_performed(motions[k], _SEED + 1000 * seed + k)))
            for k in simulated
        ],
    }
    rows = tuple(_row(name, k, groups.values()) for k, name in enumerate(_FIGURES))
    return Study(
        name="cleaned-takes",
        title=f"{len(files)} recorded and {len(motions)} simulated takes, cleaned",
        columns=(
            "figure",
            *(f"{g}_{end}" for g in groups for end in ("mean", "worst")),
        ),
        rows=(("takes", len(files) or None, None, len(motions), None), *rows),
        panels=(_panel(groups, 0), _panel(groups, 5)),
        across=2,
    )


def _performed(motion: str, seed: int) -> Take:
    return simulate("basic", motion, seed=seed).take


def _figures(result: CleanResult) -> list[float]:
    """Return the figures of a take, in the order of _FIGURES."""
    stages, trace = result.stages, result.trace
    assert trace is not None  # there is none without physics
    raw, before, after = (stages[key] for key in ("raw", "corrected", "physics"))
    return [
        after.skate_mm_per_frame,
        100.0 * after.skate_share_over_0p2,
        after.penetration_mean_mm,
        after.penetration_mm,
        after.float_mm,
        after.jitter / raw.jitter,
        after.bone_length_cv,
        after.amplitude_kept / before.amplitude_kept,
        after.peak_hand_speed / before.peak_hand_speed,
        after.amplitude_kept,
        100.0 * float(trace.tracking_error.mean()),
        float(trace.external_force.mean()),
        100.0 * float(np.mean(result.coverage < 0.5)),
        float(trace.reset.sum()),
    ]


def _row(name: str, k: int, groups: Iterable[list[list[float]]]) -> tuple[Cell, ...]:
    """Return mean and worst of a figure for each group, None without takes."""
    cells: list[Cell] = [name]
    for takes in groups:
        values = np.array([take[k] for take in takes], dtype=float)
        values = values[np.isfinite(values)]
        found = len(values) > 0
        cells += (
            [float(values.mean()), float(_FIGURES[name](values))]
            if found
            else [
                None,
                None,
            ]
        )
    return tuple(cells)


def _panel(groups: dict[str, list[list[float]]], k: int) -> Panel:
    """Return a figure of every take, from the best to the worst."""
    lines: Sequence[Series] = [
        Series(group, np.linspace(0.0, 100.0, len(takes)).tolist(), sorted(values))
        for group, takes in groups.items()
        if (values := [take[k] for take in takes])
    ]
    return Panel("share of the takes, %", list(_FIGURES)[k], tuple(lines))
