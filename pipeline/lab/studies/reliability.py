"""How well each way of scoring reliability finds the joints that are far off."""

from __future__ import annotations

from pathlib import Path

from kinefilter.pipeline.lab.evaluate import reliability_auc
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, over, silent
from kinefilter.pipeline.reliability.scorers import SCORERS

from .recordings import people, person
from .study import Cell, Panel, Series, Study
from .takes import CLASSES, study_takes

_FAR, _VARYING = "over_10_cm", "varying_over_7_cm"


def reliability(
    *,
    seed: int = 0,
    takes: int = 12,
    movements: int = 10,
    data: Path | None = None,
    progress: Progress = silent,
) -> Study:
    """Find joints that are over 10 cm off the truth, by their reliability alone.

    Limb joints relative to the middle of the hips, as ``evaluate`` counts them. The
    area under the ROC curve is 1 if every joint that is far off is less reliable than
    every other, and 0.5 by chance. The same over recorded clips beside marker mocap,
    where there are some.

    Args:
        seed: Draws people, performances and the sensor's errors.
        takes: How many takes of each class of Table IV.
        movements: How many of the recorded movements, from the first.
        data: Folder of recordings; None: simulated takes alone.
        progress: Wraps the loops, for a progress bar.
    """
    pairs = {
        kind: study_takes(kind, seed=seed, count=takes, progress=progress)
        for kind in CLASSES
    }
    whole = [pair for part in pairs.values() for pair in part]
    groups = {"all": whole, **{f"({kind})": part for kind, part in pairs.items()}}
    names, areas = list(groups), []
    for k in progress("score", len(groups)):
        areas.append(reliability_auc(groups[names[k]]))
    recorded = _recorded(data, seed, movements, progress)
    rows: list[tuple[Cell, ...]] = []
    for scoring in SCORERS:
        far = [area[scoring][_FAR] for area in areas]
        own = [recorded[scoring][key] if recorded else None for key in (_FAR, _VARYING)]
        rows.append((scoring, *far, areas[0][scoring][_VARYING], *own))
    return Study(
        name="reliability",
        title="Joints over 10 cm off, found by their reliability (area under ROC)",
        columns=(
            *("scoring", *names, _VARYING),
            *(f"recorded_{key}" for key in (_FAR, _VARYING)),
        ),
        rows=tuple(rows),
        panels=(
            Panel(
                "class of movement",
                "area under the ROC curve",
                tuple(
                    Series(
                        scoring,
                        names,
                        [area[scoring][_FAR] or 0.0 for area in areas],
                        "bars",
                    )
                    for scoring in SCORERS
                ),
            ),
        ),
    )


def _recorded(
    data: Path | None, seed: int, movements: int, progress: Progress
) -> dict[str, dict[str, float | None]]:
    """Return the areas over all recorded clips; nothing without recordings."""
    if data is None:
        return {}
    pairs: list[PairedTake] = []
    for name in over(people(data), "read", progress):
        pairs += person(data, name, seed, movements)
    return reliability_auc(pairs)
