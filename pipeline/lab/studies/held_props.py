"""Mimed lifts of a box, and dribbles of a ball: do they go where the hands do?"""

from collections.abc import Iterator
from contextlib import nullcontext
from itertools import pairwise
from unittest import mock

import numpy as np

from kinefilter import CleanConfig, CleanResult, clean
from kinefilter.characters import Take
from kinefilter.characters.rotations import matrix_from_wxyz
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.physics import world

from .study import Cell, Options, Panel, Series, Study

_SEED = 5000  # of the first performance; the rules were chosen on seeds under 300
_LIFTED, _RAISED = 0.9, 0.45  # m, of the box's center
_MOTIONS = {"lift_box": (0.0, 0.25), "store_box": (0.55, 0.7)}
"""Least and greatest height [m] of the box's center where it is to be put down: on the
floor, or on the table, upright or on its side."""
_OFTEN = 5  # dribbles
_MEANS = ("peak", "force", "skate", "jitter")


def held_box(options: Options, *, count: int = 20) -> Study:
    """Count lifted boxes, and those put down where the performer did.

    Each of ``count`` performers lifts an imaginary box of another size and place than
    the scene's: from the floor back to it, or onto the table beside them. Physics gets
    the performance without errors, or as a Kinect v2 saw it. In the rows of the rival,
    the hands go where the performer's do and hold nothing.
    """
    rows: list[list[Cell]] = []
    peaks: list[Series] = []
    for motion, height in _MOTIONS.items():
        for row, results in _performances(options, "box", motion, count):
            figures = [_figures(result, height) for result in results]
            values = sorted(f["peak"] for f in figures)
            share = np.linspace(0.0, 100.0, count).tolist()
            peaks.append(Series(row, share, values))
            lifted = sum(peak > _LIFTED for peak in values)
            down = sum(bool(f["put_down"]) for f in figures)
            means = (float(np.mean([f[key] for f in figures])) for key in _MEANS)
            deepest = max(f["deepest"] for f in figures)
            rows.append([row, count, lifted, down, *means, deepest])
    header = (
        *("performances", "takes", "lifted_over_90_cm", "put_down"),
        *("peak_m", "force_body_weights", "skate_mm_per_frame", "jitter_m_per_s3"),
        "deepest_corner_mm",
    )
    title = f"{count} performers lift a box in the box scene"
    panel = Panel("performances, %", "height of the box, m", peaks)
    return Study(title, header, rows, [panel])


def dribbled_ball(options: Options, *, count: int = 20) -> Study:
    """Count the times that a ball is dribbled, as ``held_box`` counts lifted boxes.

    Each performer picks up an imaginary ball near the scene's, and dribbles it with one
    hand six times or more. A dribble is a bounce within a second from hand to hand.
    """
    rows: list[list[Cell]] = []
    panel: list[Series] = []
    for row, results in _performances(options, "basketball", "dribble", count):
        dribbles = sorted(map(count_dribbles, results))
        panel.append(Series(row, np.linspace(0.0, 100.0, count).tolist(), dribbles))
        five = sum(number >= _OFTEN for number in dribbles)
        force = np.mean([result.clip.external_force.mean() for result in results])
        jitter = np.mean([result.stages["physics"].jitter for result in results])
        mean = float(np.mean(dribbles))
        rows.append([row, count, five, mean, float(force), float(jitter)])
    header = (
        *("performances", "takes", "dribbled_five_times", "dribbles"),
        *("force_body_weights", "jitter_m_per_s3"),
    )
    title = f"{count} performers dribble a ball in the basketball scene"
    axes = "performances, %", "times that the ball is dribbled"
    return Study(title, header, rows, [Panel(*axes, panel)])


def count_dribbles(result: CleanResult) -> int:
    """Return how often the ball of a clip goes from hand to floor to hand."""
    clip = result.clip
    (ball,) = (prop for prop in clip.props if prop.name == "ball")
    radius, height = ball.shapes[0].half_extents[0], ball.positions[:, 1]
    hands = clip.positions[:, clip.skeleton.sides("Hand")]
    away = np.linalg.norm(hands - ball.positions[:, None], axis=-1).min(axis=1)
    held = np.flatnonzero((away < 2.0 * radius) & (height > 3.0 * radius))
    gaps = [slice(a, b) for a, b in pairwise(held) if b - a > 1]
    return sum(
        bool(height[gap].min() < 2.5 * radius and np.ptp(clip.time[gap]) < 1.0)
        for gap in gaps
    )


def _performances(
    options: Options, scene: str, motion: str, count: int
) -> Iterator[tuple[str, list[CleanResult]]]:
    """Yield the name of a row, and what comes of all performances."""
    first = _SEED + 1000 * options.seed
    simulated = options.progress(motion, count)
    pairs = [simulate(scene, motion, seed=first + k) for k in simulated]
    seen, known = [pair.take for pair in pairs], list(map(truth_of, pairs))
    for name, takes in (("as performed", known), ("seen by a Kinect", seen)):
        for holds in (True, False):
            row = f"{motion}, {name}" if holds else f"{motion}, {name}, not held"
            runs = options.progress(row, count)
            yield row, [cleaned_in(scene, takes[k], holds=holds) for k in runs]


def cleaned_in(scene: str, take: Take, *, holds: bool) -> CleanResult:
    """Clean a take in a scene, in which hands hold things or never do."""
    with nullcontext() if holds else mock.patch.object(world, "add_ties"):
        return clean(take, CleanConfig(scene=scene))


def _figures(result: CleanResult, end: tuple[float, float]) -> dict[str, float]:
    (box,) = (prop for prop in result.clip.props if prop.name == "box")
    heights = box.positions[:, 1]
    half = np.abs(matrix_from_wxyz(box.rotations)[:, 1]) @ box.shapes[0].half_extents
    quality = result.stages["physics"]
    return {
        "peak": float(heights.max()),
        "put_down": float(heights.max() > _RAISED and end[0] < heights[-1] < end[1]),
        "force": float(result.clip.external_force.mean()),
        "skate": quality.skate_mm_per_frame,
        "jitter": quality.jitter,
        "deepest": 1e3 * float(max((half - heights).max(), 0.0)),
    }
