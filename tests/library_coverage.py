"""Print how well the built-in motion library covers real mocap.

    python tests/library_coverage.py ../shared/data

For every real posture, the nearest posture of the library, both on the standard body,
moved so that the middles of the hips meet, both facing +z, over the joints that the
mocap has. Two distances, each to its own nearest posture, in cm: `mean` is the mean
over joints of the Euclidean distance, `rms` the root of the mean of its square.

Sources: CMU's mocap and the marker mocap of ui-prmd, each brought to the standard body
by its own bones. And `paired`: the latter by the bones of the person's Kinect skeleton,
as training does; where a Kinect measures short legs, those of the mocap come out too
long there, by 17 cm at the ankles. Libraries: the filtered one that ships, one of the
size of Shum's, and all postures.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from kinefilter.characters import KINECT_V1, State, Take
from kinefilter.pipeline.database import filter_to_count
from kinefilter.pipeline.formats.mocap import read_mocap
from kinefilter.pipeline.lab.database_build import (
    BUILTIN_POSTURES,
    FILTERED_POSTURES,
    mocap_postures,
    scripted_postures,
)
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.reliability import measure_reference
from kinefilter.retarget import Standardizer, measured_body

Array = NDArray[np.float64]

HIPS = [KINECT_V1.index("HipLeft"), KINECT_V1.index("HipRight")]
MOVEMENTS = {
    "m01": "deep squat",
    "m02": "hurdle step",
    "m03": "inline lunge",
    "m04": "side lunge",
    "m05": "sit to stand",
    "m06": "leg raise",
    "m07": "shoulder abduction",
    "m08": "shoulder extension",
    "m09": "shoulder rotation",
    "m10": "shoulder scaption",
}
_CANDIDATES = 40  # nearest by rms among which the nearest by mean is looked for
_BLOCK = 256
print_line = Console(soft_wrap=True, highlight=False).print


def centered(postures: Array) -> Array:
    """Return postures with the middle of the hips at the origin, (N, J, 3)."""
    return np.asarray(postures - postures[:, HIPS].mean(axis=1, keepdims=True))


def nearest(real: Array, library: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return mean and rms distance [m] to the nearest posture, and which it is.

    Args:
        real: Postures [m], NaN where a joint is missing, shape (N, J, 3).
        library: Postures to compare with [m], shape (M, J, 3).
    """
    real, library = centered(real), centered(library)
    there = ~np.isnan(real).any(axis=2)
    real = np.where(there[..., None], real, 0.0)
    flat = library.reshape(len(library), -1)
    squares = np.sum(library**2, axis=2)
    mean, rms = np.empty(len(real)), np.empty(len(real))
    which = np.empty(len(real), dtype=np.intp)
    for start in range(0, len(real), _BLOCK):
        rows = slice(start, start + _BLOCK)
        part, mask = real[rows], there[rows].astype(float)
        count = mask.sum(axis=1)
        total = mask @ squares.T - 2.0 * part.reshape(len(part), -1) @ flat.T
        total += np.sum(part**2, axis=(1, 2))[:, None]
        close = np.argpartition(total, min(_CANDIDATES, len(flat)) - 1, axis=1)
        close = close[:, :_CANDIDATES]
        away = np.linalg.norm(library[close] - part[:, None], axis=3) * mask[:, None]
        away = away.sum(axis=2) / count[:, None]
        best = away.argmin(axis=1)
        each = np.arange(len(part))
        mean[rows], which[rows] = away[each, best], close[each, best]
        rms[rows] = np.sqrt(np.maximum(total.min(axis=1), 0.0) / count)
    return mean, rms, which


def standardized(positions: Array) -> Array:
    """Return a recording [m], NaN where missing, on the standard body, (T, J, 3).

    As a take of the same joints would be seen by a correction.
    """
    state = np.where(np.isnan(positions[..., 0]), State.NOT_TRACKED, State.TRACKED)
    time = np.arange(len(positions)) / 30.0
    take = Take(time, positions, state.astype(np.uint8), KINECT_V1, "mocap")
    reference = measure_reference(take)
    body = measured_body(KINECT_V1, reference.lengths, reference.directions)
    weights = np.ones(positions.shape[:2])
    return Standardizer(body).steps(positions, weights)[0]


def read_ui_prmd(folder: Path, every: int) -> list[PairedTake]:
    """Return every so many clips of each person, about evenly over the movements."""
    files = sorted(folder.glob("s*.npz"))
    return [pair for file in files for pair in read_pairs(file)[::every]]


def read_cmu(folder: Path, every: int) -> tuple[Array, NDArray[np.str_]]:
    """Return the postures of BVH files, 30 a second thinned, and each one's file."""
    postures, clips = [], []
    for file in sorted(folder.glob("*.bvh.gz")):
        found = mocap_postures(read_mocap(file), KINECT_V1)
        found = standardized(found)[::every]
        postures.append(found)
        clips.append(np.full(len(found), file.name.split(".")[0]))
    return np.concatenate(postures), np.concatenate(clips)


def print_source(
    name: str,
    real: Array,
    groups: NDArray[np.str_],
    libraries: dict[str, Array],
    labels: NDArray[np.str_],
) -> None:
    """Print a line of the source and one of each group, in cm."""
    seen = ~np.isnan(real[:, HIPS]).any(axis=(1, 2))
    real, groups = real[seen], groups[seen]
    found = {size: nearest(real, library) for size, library in libraries.items()}
    head = "".join(f"{size:>34s}" for size in libraries)
    print_line(f"\n{name}: {len(real)} postures{'':4s}\n{'':22s}{head}")
    print_line(f"{'':22s}" + "   mean: median  p90   rms: med p90" * len(libraries))
    rows: list[tuple[str, NDArray[np.bool_]]] = [("all", np.ones(len(real), bool))]
    rows += [(g, groups == g) for g in sorted(set(groups.tolist()))]
    for group, mask in rows:
        line = f"  {group:20s}"
        for mean, rms, _ in found.values():
            figures = [
                np.percentile(100 * d[mask], q) for d in (mean, rms) for q in (50, 90)
            ]
            line += "{:15.1f}{:6.1f}{:9.1f}{:5.1f}".format(*figures)
        which = labels[found["shipped"][2][mask]]
        names, counts = np.unique(which, return_counts=True)
        top = [
            f"{names[k]} {100 * counts[k] // len(which)} %"
            for k in counts.argsort()[::-1][:3]
        ]
        print_line(f"{line}   {', '.join(top)}")
    mean, _, which = found["shipped"]
    medians = [(np.median(mean[mask]) * 100, group) for group, mask in rows[1:]]
    far = sorted(medians, reverse=True)[:4]
    print_line("  worst: " + ", ".join(f"{group} {cm:.1f}" for cm, group in far))
    apart = centered(real) - centered(libraries["shipped"])[which]
    away = np.linalg.norm(apart, axis=2)
    known = np.maximum((~np.isnan(away)).sum(axis=0), 1)
    joints = np.nansum(away, axis=0) / known * 100
    order = np.argsort(-joints)[:6]
    worst = ", ".join(f"{KINECT_V1.joints[j]} {joints[j]:.1f}" for j in order)
    print_line(f"  worst joints, mean cm: {worst}")


def movement(clip: str) -> str:
    """Return the name of a ui-prmd clip's movement and whether it was done wrong."""
    number = clip[:3]
    wrong = ", wrong" if clip.endswith("_inc") else ""
    return f"{number} {MOVEMENTS[number]}{wrong}"[:20]


def read_libraries() -> tuple[dict[str, Array], NDArray[np.str_]]:
    """Return libraries of three sizes, and the motions of the one that ships."""
    start = time.perf_counter()
    parts = list(scripted_postures(KINECT_V1))
    postures = np.concatenate([p for _, p in parts])
    labels = np.concatenate([np.full(len(p), name) for name, p in parts])
    kept = filter_to_count(postures, BUILTIN_POSTURES)
    seconds = time.perf_counter() - start
    print_line(
        f"{len(set(labels.tolist()))} motions, {len(postures)} postures, "
        f"{len(kept)} after the filter, built in {seconds:.1f} s"
    )
    libraries = {
        "shipped": postures[kept],
        "Shum's size": postures[filter_to_count(postures, FILTERED_POSTURES)],
        "all": postures,
    }
    return libraries, labels[kept]


def main() -> None:
    """Read the recordings and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("data", type=Path, help="folder with ui-prmd and mocap/cmu")
    parser.add_argument("--every", type=int, default=4, help="clips taken, one in")
    options = parser.parse_args()
    libraries, labels = read_libraries()
    pairs = read_ui_prmd(options.data / "ui-prmd", options.every)
    groups = np.concatenate([np.full(len(p.take), movement(p.clip)) for p in pairs])
    own = np.concatenate([standardized(p.truth) for p in pairs])
    for name, real in (("mocap", own), ("paired", training_set(pairs).truth)):
        print_source(f"ui-prmd, {name}", real, groups, libraries, labels)
    real, clips = read_cmu(options.data / "mocap" / "cmu", options.every)
    subjects = np.array([f"subject {clip[:2]}" for clip in clips.tolist()])
    print_source("CMU", real, subjects, libraries, labels)


if __name__ == "__main__":
    main()
