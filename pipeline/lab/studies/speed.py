"""How long a frame takes, stage by stage: the figures of ``kinefilter bench``."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinefilter.pipeline.lab.bench import bench
from kinefilter.pipeline.progress import Progress, silent

from .study import Panel, Series, Study

_STAGES = ("reliability", "correct", "orientation", "physics", "total")


def speed(*, seed: int = 0, rounds: int = 3, progress: Progress = silent) -> Study:
    """Time every stage on the sample take, frame by frame on one core.

    Medians over the rounds; ratios are taken within a round, so that a machine which
    is slower a minute later does not spoil them.

    Args:
        seed: Of no consequence: the take is always the same.
        rounds: How many times everything is timed.
        progress: Wraps the loop over the rounds, for a progress bar.
    """
    del seed
    found = [_figures(bench()) for _ in progress("time", rounds)]
    medians = {key: float(np.median([one[key] for one in found])) for key in found[0]}
    stages = [medians[f"{stage}, ms a frame"] for stage in _STAGES]
    return Study(
        name="speed",
        title="Speed, frame by frame on one core",
        columns=("what", "value"),
        rows=tuple(medians.items()),
        panels=(
            Panel("stage", "ms a frame", (Series("stages", _STAGES, stages, "bars"),)),
        ),
    )


def _figures(timed: dict[str, Any]) -> dict[str, float]:
    """Return the figures of one round by what they are."""
    stages, search, offline = timed["ms_per_frame"], timed["search"], timed["offline"]
    bare = timed["mj_step_ms_per_frame"]
    return {
        **{f"{stage}, ms a frame": stages[stage] for stage in _STAGES},
        "mj_step alone, ms a frame": bare,
        "physics over mj_step": stages["physics"] / bare,
        "all stages over mj_step": stages["total"] / bare,
        "sampling over solver": search["times_faster"],
        "frames with lower energy than sampling, %": 100.0
        * search["share_of_frames_lower_energy"],
        "cores": offline["cores"],
        "whole takes, frames a second": offline["frames_per_second"],
    }
