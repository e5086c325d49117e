"""Print the figures of README from recorded data.

    python tests/figures.py ../shared/data

Takes: every recording under takes/, cleaned with the defaults. Paired: every fifth
clip of the people that nothing was chosen on, against marker mocap; E and E_var in cm
as the data's README defines them (mean over joints and frames; without each joint's
constant offset per clip).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from kinefilter.characters import KINECT_V1, State, Take
from kinefilter.pipeline import CleanConfig, clean, read_take

Array = NDArray[np.float64]

PEOPLE = ("s03", "s06", "s07", "s08")
LIMBS = [
    KINECT_V1.index(part + side)
    for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
    for side in ("Left", "Right")
]
HIPS = [KINECT_V1.index("HipLeft"), KINECT_V1.index("HipRight")]
CONFIGS = {
    "none": CleanConfig(method="none", physics=False),
    "none, physics": CleanConfig(method="none"),
    "default": CleanConfig(physics=False),
    "default, physics": CleanConfig(),
}
print_line = Console(soft_wrap=True, highlight=False).print


def paired_takes(file: Path, every: int) -> Iterator[tuple[Take, Array]]:
    """Yield takes and the marker mocap beside them [m], shape (T, 20, 3)."""
    with np.load(file, allow_pickle=False) as pairs:
        arrays = {key: pairs[key] for key in ("kinect", "mocap", "start", "stop")}
    spans = zip(arrays["start"], arrays["stop"], strict=True)
    for start, stop in list(spans)[::every]:
        kinect = arrays["kinect"][start:stop].astype(float)
        missing = np.isnan(kinect[..., 0])
        state = np.where(missing, State.NOT_TRACKED, State.TRACKED).astype(np.uint8)
        time = np.arange(len(kinect)) / 30.0
        take = Take(time, kinect, state, KINECT_V1, file.stem)
        yield take, arrays["mocap"][start:stop].astype(float)


def errors(positions: Array, truth: Array) -> tuple[Array, Array]:
    """Return distances [m] of the limb joints, and those without their mean offset."""
    away = positions - positions[:, HIPS].mean(axis=1, keepdims=True)
    away = (away - truth + truth[:, HIPS].mean(axis=1, keepdims=True))[:, LIMBS]
    seen = ~np.isnan(away).all(axis=(0, 2))
    away = away[:, seen]
    centered = away - np.nanmean(away, axis=0)
    return np.linalg.norm(away, axis=2).ravel(), np.linalg.norm(
        centered, axis=2
    ).ravel()


def print_takes(folder: Path) -> None:
    """Clean every recorded take and print the extremes."""
    raw, final, coverage, resets = [], [], [], 0
    files = sorted([*folder.glob("*/*.csv"), *folder.glob("*/*.csv.gz")])
    for file in files:
        result = clean(read_take(file))
        raw.append(result.stages["raw"])
        final.append(result.stages["physics"])
        coverage.append(result.coverage)
        resets += 0 if result.trace is None else int(result.trace.reset.sum())
    jitter = [b.jitter / a.jitter for a, b in zip(raw, final, strict=True)]
    lengths = [max(q.bone_length_cv for q in stage) for stage in (raw, final)]
    figures = {
        "jitter, share of raw, median": np.median(jitter),
        "jitter, share of raw, worst": max(jitter),
        "bone-length variation, raw, worst": lengths[0],
        "bone-length variation, clip, worst": lengths[1],
        "lowest point of the body, worst, mm": min(q.lowest_point_mm for q in final),
        "amplitude kept, median": np.median([q.amplitude_kept for q in final]),
        "share of frames outside the database": np.mean(np.concatenate(coverage) < 0.5),
        "simulation resets": resets,
    }
    print_line(f"{len(files)} recorded takes")
    for name, value in figures.items():
        print_line(f"  {name:38s} {value:.3g}")


def print_pairs(folder: Path) -> None:
    """Print errors against marker mocap, mean over people."""
    table: dict[str, list[tuple[float, float]]] = {}
    for person in PEOPLE:
        found: dict[str, list[tuple[Array, Array]]] = {}
        for take, truth in paired_takes(folder / f"{person}.npz", every=5):
            found.setdefault("raw", []).append(errors(take.positions, truth))
            for name, config in CONFIGS.items():
                clip = clean(take, config).clip
                found.setdefault(name, []).append(errors(clip.positions, truth))
        for name, pairs in found.items():
            whole, varying = (np.concatenate(part) for part in zip(*pairs, strict=True))
            table.setdefault(name, []).append(
                (float(np.nanmean(whole)) * 100, float(np.nanmean(varying)) * 100)
            )
    print_line(f"{len(PEOPLE)} people against marker mocap: E, E_var in cm")
    for name, rows in table.items():
        mean = np.mean(rows, axis=0)
        each = ", ".join(f"{row[1]:.2f}" for row in rows)
        print_line(f"  {name:20s} {mean[0]:.2f}  {mean[1]:.2f}  (E_var each: {each})")


if __name__ == "__main__":
    data = Path(sys.argv[1])
    print_takes(data / "takes")
    print_pairs(data / "ui-prmd")
