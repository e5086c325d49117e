"""What ``clean`` makes of takes by default: their quality, and things that are held.

Mimed lifts of a box and dribbles of a ball: do they go where the hands do?
"""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from functools import partial
from itertools import pairwise
from unittest import mock

import numpy as np

from kinefilter import CleanConfig, CleanResult, clean, read_take
from kinefilter.characters import Clip, Skeleton, Take
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    inverse,
    matrix_from_wxyz,
    multiply,
    rotation_vector,
    unit,
)
from kinefilter.pipeline.lab.simulation import simulate, truth_of
from kinefilter.pipeline.physics import world
from kinefilter.pipeline.physics.seat import Seat
from kinefilter.pipeline.progress import over
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.scenes.library import MOTIONS

from .study import Cell, Options, Panel, Series, Study
from .study_takes import recorded_takes

_SEED = 4000  # of the first simulated take, above the seeds in the database
_PLOTTED = ("feet slide, mm a frame", "jitter, share of raw")
_LOW_IS_WORSE = (
    "amplitude, after over before physics",
    "peak hand speed, after over before physics",
    "amplitude, share of raw",
)


def cleaned_takes(options: Options, *, count: int = 1000) -> Study:
    """Clean every recorded take, and a simulated take of every motion, with defaults.

    Figures are those of ``clean --json`` after physics: mean over takes, and worst
    take; shares are relative to the same take before cleaning. At most ``count``
    recorded and ``count`` simulated takes are cleaned.
    """
    files, motions = recorded_takes(options.data)[:count], MOTIONS[:count]
    first = _SEED + 1000 * options.seed
    groups = {
        "recorded": [
            _figures(take := read_take(file), clean(take))
            for file in over(files, "recorded takes", options.progress)
        ],
        "simulated": [
            _figures(pair.take, clean(pair.take), pair.truth)
            for k in options.progress("simulated takes", len(motions))
            for pair in [simulate("basic", motions[k], seed=first + k)]
        ],
    }
    figures = {
        name: {group: [take[name] for take in takes] for group, takes in groups.items()}
        for name in groups["simulated"][0]
    }
    rows: list[list[Cell]] = [["takes", len(files) or None, None, len(motions), None]]
    for name, by_group in figures.items():
        rows.append([name])
        for values in by_group.values():
            rows[-1] += _mean_and_worst(name, values)
    title = f"{len(files)} recorded and {len(motions)} simulated takes, cleaned"
    ends = ("mean", "worst")
    header = ("figure", *(f"{group}_{end}" for group in groups for end in ends))
    panels = [_sorted_takes(name, figures[name]) for name in _PLOTTED]
    return Study(title, header, rows, panels, across=2)


def _figures(
    take: Take, result: CleanResult, truth: Array | None = None
) -> dict[str, float]:
    stages, trace = result.stages, result.trace
    assert trace is not None  # physics always leaves one
    raw, before, after = (stages[key] for key in ("raw", "corrected", "physics"))
    amplitude = after.amplitude_kept / before.amplitude_kept
    hand_speed = after.peak_hand_speed / before.peak_hand_speed
    stands = planted_feet(result.clip.contacts)
    return {
        "feet slide, mm a frame": after.skate_mm_per_frame,
        "feet over 0.2 m/s, %": 100.0 * after.skate_share_over_0p2,
        "frames on neither foot, %": 100.0 * float(np.mean(~stands.any(axis=1))),
        "body under the floor, mean, mm": after.penetration_mean_mm,
        "body under the floor, most, mm": after.penetration_mm,
        "standing soles float, mm": after.float_mm,
        "jitter, share of raw": after.jitter / raw.jitter,
        "bone-length variation": after.bone_length_cv,
        "amplitude, after over before physics": amplitude,
        "peak hand speed, after over before physics": hand_speed,
        "amplitude, share of raw": after.amplitude_kept,
        "wrists bent over 60 degrees, raw, %": _bent(take.positions, take.skeleton),
        "wrists bent over 60 degrees, %": _bent(result.clip.positions, take.skeleton),
        "hands off their direction, raw, degrees": _off(take, take.positions, truth),
        "hands along forearms, degrees": _off(take, result.clip.positions, truth, 1),
        "hands off their direction, degrees": _off(take, result.clip.positions, truth),
        "joints beyond their range, % of frames": _beyond(result.clip),
        "distance from the target, cm": 100.0 * float(trace.tracking_error.mean()),
        "external force, body weights": float(trace.external_force.mean()),
        "unexplained force, body weights": after.unexplained_force,
        "frames outside the database, %": 100.0 * float(np.mean(result.coverage < 0.5)),
        "simulation resets": float(trace.reset.sum()),
    }


def _bent(positions: Array, skeleton: Skeleton) -> float:
    sides = map(skeleton.sides, ("Elbow", "Wrist", "Hand"))
    elbows, wrists, hands = (positions[:, pair] for pair in sides)
    cosine = np.vecdot(unit(wrists - elbows), unit(hands - wrists))
    seen = np.isfinite(cosine)
    bent = np.count_nonzero(cosine[seen] < np.cos(np.radians(60.0)))
    return 100.0 * bent / seen.sum() if seen.any() else np.nan


def _beyond(clip: Clip) -> float:
    """Return the share of frames with a joint over 2 degrees beyond its range [%]."""
    ends, starts = clip.skeleton.segments, clip.skeleton.segment_parents
    relative = multiply(inverse(clip.rotations[:, starts]), clip.rotations[:, ends])
    most = np.array([joint_range(clip.skeleton.joints[j]) for j in ends])
    over = np.linalg.norm(rotation_vector(relative), axis=-1) > most + np.radians(2.0)
    return 100.0 * float(over.any(axis=1).mean())


def _off(take: Take, positions: Array, truth: Array | None, before: int = 0) -> float:
    """Return how far hands, or bones some ``before``, point off the truth [degrees]."""
    if truth is None:
        return np.nan
    parts = [take.skeleton.sides(part) for part in ("Hand", "Wrist", "Elbow")]
    ends, starts = parts[before : before + 2]
    found = unit(positions[:, ends] - positions[:, starts])
    true = unit(truth[:, parts[0]] - truth[:, parts[1]])
    cosine = np.clip(np.vecdot(found, true), -1.0, 1.0)
    return float(np.degrees(np.nanmean(np.arccos(cosine))))


def _mean_and_worst(name: str, values: Sequence[float]) -> tuple[Cell, Cell]:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return None, None
    return float(np.mean(known)), min(known) if name in _LOW_IS_WORSE else max(known)


def _sorted_takes(name: str, by_group: dict[str, list[float]]) -> Panel:
    lines = [_sorted(group, values) for group, values in by_group.items() if values]
    return Panel("share of the takes, %", name, lines)


def _sorted(label: str, values: Sequence[float]) -> Series:
    shares = np.linspace(0.0, 100.0, len(values)).tolist()
    return Series(label, shares, sorted(values))


_FIRST_MIME = 5000  # of the first performance; the rules were chosen on seeds under 300
_LIFTED, _RAISED = 0.9, 0.45  # m, of the box's center
_MOTIONS = {"lift_box": (0.0, 0.25), "store_box": (0.55, 0.7)}
"""Least and greatest height [m] of the box's center where it is to be put down: on the
floor, or on the table, upright or on its side."""
_OFTEN = 5  # dribbles
_SEATED = (("chair", "sit_to_stand"), ("chair", "chair"), ("office", "office"))
_MEANS = ("peak", "force", "skate", "jitter")
_RIVALS = {
    "not held": partial(mock.patch.object, world, "add_ties"),
    "no seat": partial(mock.patch.object, Seat, "_is_borne", return_value=False),
}
"""What physics does without: hands that hold things, and seats that bear."""


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
            figures = [_figures_held(result, height) for result in results]
            values = [f["peak"] for f in figures]
            peaks.append(_sorted(row, values))
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
        dribbles = list(map(count_dribbles, results))
        panel.append(_sorted(row, dribbles))
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


def chairs(options: Options, *, count: int = 10) -> Study:
    """Measure the pulls on performers who sit in a scene, with seats that bear or not.

    Physics gets the performance as it was, or as a Kinect v2 saw it. Without seats, the
    target stays inside of what it meets.
    """
    rows: list[list[Cell]] = []
    panel: list[Series] = []
    for scene, motion in _SEATED:
        for row, results in _performances(options, scene, motion, count, "no seat"):
            figures = np.transpose([_figures_seated(result) for result in results])
            panel.append(_sorted(row, figures[0].tolist()))
            rows.append([row, count, *figures.mean(axis=1).tolist()])
    header = (
        *("performances", "takes", "force_body_weights", "force_95_body_weights"),
        *("jitter_m_per_s3", "skate_mm_per_frame"),
    )
    title = f"{count} performers sit in scenes with a chair"
    axes = "performances, %", "external force, body weights"
    return Study(title, header, rows, [Panel(*axes, panel)])


def _figures_seated(result: CleanResult) -> list[float]:
    force, quality = result.clip.external_force, result.stages["physics"]
    most = float(np.quantile(force, 0.95))
    return [float(force.mean()), most, quality.jitter, quality.skate_mm_per_frame]


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
    options: Options, scene: str, motion: str, count: int, rival: str = "not held"
) -> Iterator[tuple[str, list[CleanResult]]]:
    """Yield the name of a row, and what comes of all performances.

    They are taken as they were, then as seen; each by physics, then by its rival.
    """
    first = _FIRST_MIME + 1000 * options.seed
    simulated = options.progress(motion, count)
    pairs = [simulate(scene, motion, seed=first + k) for k in simulated]
    truth, seen = list(map(truth_of, pairs)), [pair.take for pair in pairs]
    for name, takes in (("as performed", truth), ("seen by a Kinect", seen)):
        for without in (None, rival):
            row = ", ".join(filter(None, (motion, name, without)))
            runs = options.progress(row, count)
            yield row, [cleaned_in(scene, takes[k], without) for k in runs]


def cleaned_in(scene: str, take: Take, without: str | None = None) -> CleanResult:
    """Clean a take in a scene, without what one of ``_RIVALS`` lacks."""
    with _RIVALS[without]() if without else nullcontext():
        return clean(take, CleanConfig(scene=scene))


def _figures_held(result: CleanResult, end: tuple[float, float]) -> dict[str, float]:
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
