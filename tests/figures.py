"""Print the figures of README from recorded data.

    python tests/figures.py ../shared/data

Takes: every recording under takes/, then a simulated one of every motion, cleaned
with the defaults. Paired: every fifth
clip of people on whom little was chosen, against marker mocap; E and E_var in cm
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
from rich.progress import track

from kinefilter.characters import KINECT_V1, State, Take
from kinefilter.pipeline import CleanConfig, CleanResult, clean, read_take
from kinefilter.pipeline.metrics import Quality, jitter
from kinefilter.pipeline.simulate import simulate
from kinefilter.scenes import MOTIONS

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
    """Clean every recorded take and print what physics made of them."""
    files = sorted([*folder.glob("*/*.csv"), *folder.glob("*/*.csv.gz")])
    results = [clean(read_take(file)) for file in track(files, "takes")]
    _print_quality(f"{len(files)} recorded takes", results)
    for group in sorted({file.parent.name for file in files}):
        own = [r for r, f in zip(results, files, strict=True) if f.parent.name == group]
        _print_quality(f"  of them {group}", own)


def print_simulated() -> None:
    """The same for a simulated take of every motion."""
    takes = [
        simulate("basic", motion, seed=4000 + k).take
        for k, motion in enumerate(track(MOTIONS, "simulated"))
    ]
    _print_quality(f"{len(takes)} simulated takes", [clean(take) for take in takes])


def _print_quality(title: str, results: list[CleanResult]) -> None:
    raw, before, after = (
        {
            key: np.array([getattr(result.stages[stage], key) for result in results])
            for key in Quality.__dataclass_fields__
        }
        for stage in ("raw", "corrected", "physics")
    )
    traces = [result.trace for result in results if result.trace is not None]
    coverage = np.concatenate([result.coverage for result in results])
    kept = after["peak_hand_speed"] / before["peak_hand_speed"]
    amplitude = after["amplitude_kept"] / before["amplitude_kept"]
    trembling = after["jitter"] / raw["jitter"]
    figures = {
        "feet slide, mm/frame": (after["skate_mm_per_frame"], np.max),
        "feet over 0.2 m/s, %": (100.0 * after["skate_share_over_0p2"], np.max),
        "under the floor, mean, mm": (after["penetration_mean_mm"], np.max),
        "under the floor, most, mm": (after["penetration_mm"], np.max),
        "standing soles float, mm": (after["float_mm"], np.max),
        "jitter, share of raw": (trembling, np.max),
        "bone-length variation": (after["bone_length_cv"], np.max),
        "amplitude after / before physics": (amplitude, np.min),
        "peak hand speed after / before": (kept, np.min),
        "amplitude kept of raw": (after["amplitude_kept"], np.min),
        "from target, cm": (
            np.array([100.0 * trace.tracking_error.mean() for trace in traces]),
            np.max,
        ),
        "external force, body weights": (
            np.array([trace.external_force.mean() for trace in traces]),
            np.max,
        ),
        "frames outside the database, %": (100.0 * (coverage < 0.5), np.mean),
        "simulation resets": (
            np.array([trace.reset.sum() for trace in traces]),
            np.max,
        ),
    }
    print_line(f"{title}: mean, worst")
    for name, (values, worst) in figures.items():
        values = values[np.isfinite(values)]
        print_line(f"  {name:34s} {values.mean():8.3g} {worst(values):8.3g}")


def print_pairs(folder: Path) -> None:
    """Print errors against marker mocap, mean over people."""
    table: dict[str, list[tuple[float, float]]] = {}
    jitters: list[list[float]] = []
    for person in PEOPLE:
        found: dict[str, list[tuple[Array, Array]]] = {}
        for take, truth in paired_takes(folder / f"{person}.npz", every=5):
            found.setdefault("raw", []).append(errors(take.positions, truth))
            for name, config in CONFIGS.items():
                clip = clean(take, config).clip
                found.setdefault(name, []).append(errors(clip.positions, truth))
                if name == "default, physics":
                    jitters.append(
                        [
                            jitter(take.time, motion[:, LIMBS])
                            for motion in (clip.positions, truth)
                        ]
                    )
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
    clip, mocap = np.mean(jitters, axis=0)
    print_line(f"  jitter of the limbs: {clip:.1f}, the mocap's {mocap:.1f} m/s^3")


if __name__ == "__main__":
    data = Path(sys.argv[1])
    print_takes(data / "takes")
    print_simulated()
    print_pairs(data / "ui-prmd")
