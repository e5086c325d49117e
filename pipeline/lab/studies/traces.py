"""A joint followed through a motion, as plotted in the papers, and its mean error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinefilter.pipeline.lab.accuracy import LIMBS
from kinefilter.pipeline.metrics import jitter

from .study import Options, Panel, Row, Series, Study
from .trial import mean_cm, simulated


@dataclass(frozen=True)
class Trace:
    """A joint to follow through a motion."""

    motion: str
    joint: str
    """One of ``LIMBS``."""
    paper: Mapping[str, float | None]
    """The paper's mean errors [cm]: of ``kinect`` first, then of presets."""


def trace_study(
    options: Options,
    title: str,
    traces: Sequence[Trace],
    *,
    people: int,
    sensor: str,
    standard: bool = False,
) -> Study:
    """Return errors of joints, and plot them through a take of a known person.

    ``people`` are in the training data, and a quarter as many are tested. With
    ``standard``, both motions are brought to standard segment lengths first. Jitter is
    the mean third difference [m/s^3].
    """
    rows, panels = list[Row](), list[Panel]()
    for trace in traces:
        groups = simulated(options, [trace.motion], learners=people, sensor=sensor)
        k, name = LIMBS.index(trace.joint), f"{trace.joint}, {trace.motion}"
        lines = []
        _, *presets = trace.paper
        for n, (system, paper) in enumerate(trace.paper.items()):
            errors, jitters = [], []
            for group in groups:
                run, accuracy = group.runners(presets)[n], group.accuracy
                motions = [run(pair.take) for pair in group.tests]
                distances = accuracy.standardized if standard else accuracy.distances
                both = zip(motions, group.tests, strict=True)
                found = [distances(motion, pair.truth)[:, k] for motion, pair in both]
                errors.append(mean_cm(*found))
                joint = [motion[:, [accuracy.limbs[k]]] for motion in motions]
                times = [pair.take.time for pair in group.tests]
                jitters.append(float(np.mean([*map(jitter, times, joint)])))
            rows.append((f"{name}, {system}", *errors, *jitters, paper))
            line = 100.0 * np.nan_to_num(found[0])
            lines.append(Series(system, times[0].tolist(), line.tolist()))
        panels.append(Panel(f"s, {name}", "error, cm", lines))
    header = (
        *("joint, motion, system", "new_cm", "known_cm", "new_jitter"),
        *("known_jitter", "paper_cm"),
    )
    return Study(title, header, rows, panels, across=len(panels))
