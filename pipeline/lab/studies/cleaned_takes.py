"""Quality of the clips that ``clean`` produces with default settings."""

from collections.abc import Sequence

import numpy as np

from kinefilter import CleanResult, clean, read_take
from kinefilter.characters import Clip, Skeleton, Take
from kinefilter.characters.anthropometry import joint_range
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import inverse, multiply, rotation_vector, unit
from kinefilter.pipeline.lab.simulation import simulate
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
    lines = [
        Series(group, np.linspace(0.0, 100.0, len(values)).tolist(), sorted(values))
        for group, values in by_group.items()
        if values
    ]
    return Panel("share of the takes, %", name, lines)
