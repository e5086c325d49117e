"""A joint followed through a motion, as the papers draw it, and its mean error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinefilter.pipeline.lab.accuracy import LIMBS
from kinefilter.pipeline.metrics import jitter

from .study import Cell, Options, Panel, Series, Study
from .trial import mean_cm, simulated


@dataclass(frozen=True)
class Trace:
    """A joint of people who perform a motion."""

    motion: str
    joint: str
    """One of ``LIMBS``."""
    paper: Mapping[str, float | None]
    """The paper's mean errors [cm] of ``kinect`` and of presets."""


def trace_study(
    options: Options,
    title: str,
    traces: Sequence[Trace],
    *,
    people: int,
    sensor: str,
    standard: bool = False,
) -> Study:
    """Return errors of joints, and how far off they are in a take of somebody known.

    Jitter is the mean third difference [m/s^3].

    Args:
        options: What the study is run with.
        title: The study's.
        traces: What is followed.
        people: Who perform for the presets to learn; a quarter as many are tested.
        sensor: One of ``SENSORS``.
        standard: Whether both sides have segments of standard lengths.
    """
    rows: list[tuple[Cell, ...]] = []
    panels: list[Panel] = []
    for trace in traces:
        groups = simulated(options, [trace.motion], learners=people, sensor=sensor)
        k, what = LIMBS.index(trace.joint), f"{trace.joint}, {trace.motion}"
        lines = []
        _, *presets = trace.paper
        for n, (name, paper) in enumerate(trace.paper.items()):
            errors, shakes = [], []
            for group in groups:
                make, accuracy = group.makers(presets)[n], group.accuracy
                motions = [make(pair.take) for pair in group.tests]
                away = accuracy.standardized if standard else accuracy.distances
                both = zip(motions, group.tests, strict=True)
                found = [away(motion, pair.truth)[:, k] for motion, pair in both]
                errors.append(mean_cm(*found))
                joint = [motion[:, [accuracy.limbs[k]]] for motion in motions]
                times = [pair.take.time for pair in group.tests]
                shakes.append(np.mean([*map(jitter, times, joint)]))
            rows.append((f"{what}, {name}", *errors, *map(float, shakes), paper))
            time, line = group.tests[0].take.time, 100.0 * np.nan_to_num(found[0])
            lines.append(Series(name, time.tolist(), line.tolist()))
        panels.append(Panel(f"s, {what}", "off by, cm", lines))
    return Study(
        title=title,
        columns=(
            *("joint, motion, system", "new_cm", "known_cm", "new_jitter"),
            *("known_jitter", "paper_cm"),
        ),
        rows=rows,
        panels=panels,
        across=len(panels),
    )
