"""How much of a sensor's roll is left in takes, by what people do.

The sensor's true roll is not known. In its place stands the slope across the view of
the ankles that are planted in any take of a sensor, if they span a meter and show it to
half a degree. For each movement it prints this roll and what is left of it [degrees,
rms]. Files are named after person, place, movement and sensor.

    python tests/roll_figures.py ../shared/data/two-kinects/p1*_*_{walk,steps}_*.csv.gz
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter import CleanConfig, Cleaner, read_take
from kinefilter.characters.motion import distinct_stamps
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.workers import workers

Array = NDArray[np.float64]
_LEAST_SPAN, _MOST_ERROR = 1.0, 0.5  # m, degrees
_FRAMES_PER_STEP = 8  # that say as much as one


def found_in(file: Path) -> tuple[Array, float]:
    """Return the places of planted ankles [m], (N, 3), and the roll found [degrees]."""
    take = read_take(file)
    take = take.at(distinct_stamps(take.time))
    raw = Cleaner(CleanConfig(tilt=0.0)).until("level").whole(take)
    ankles = raw.positions[:, list(take.skeleton.sides("Ankle"))]
    found = Cleaner().until("level").whole(take)
    return ankles[raw.stands], float(np.degrees(found.roll))


def slope_of(places: Array) -> tuple[float, float]:
    """Return the slope down to the left [degrees], and its standard error."""
    x, y, z = places.T
    kept = np.ones(len(places), dtype=np.bool_)
    rows = np.stack([-x, z, np.ones_like(x)], axis=1)
    for _ in range(2):  # outliers do not count
        fit = np.linalg.lstsq(rows[kept], y[kept], rcond=None)[0]
        away = np.abs(y - rows @ fit)
        kept = away < 3.0 * np.median(away)
    error = np.linalg.inv(rows[kept].T @ rows[kept]) * np.mean(away[kept] ** 2)
    spread = np.sqrt(_FRAMES_PER_STEP * error[0, 0])
    return float(np.degrees(fit[0])), float(np.degrees(spread))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("takes", type=Path, nargs="+")
    files = sorted(parser.parse_args().takes)
    sensors = defaultdict[tuple[str, ...], list[tuple[str, Array, float]]](list)
    with workers() as pool:
        for file, found in zip(files, pool.map(found_in, files), strict=True):
            person, place, movement, sensor = file.name.partition(".")[0].split("_")
            sensors[person, place, sensor].append((movement, *found))
    left = defaultdict[str, list[tuple[float, float]]](list)
    for takes in sensors.values():
        places = np.concatenate([places for _, places, _ in takes])
        if len(places) < 3 or np.ptp(places[:, 0]) < _LEAST_SPAN:
            continue
        roll, error = slope_of(places)
        if error < _MOST_ERROR:
            for movement, _, found in takes:
                left[movement].append((roll, roll - found))
    for movement, rolls in left.items():
        shown = np.sqrt(np.mean(np.square(rolls), axis=0)).round(2)
        out.print(f"{movement}, {len(rolls)} takes: roll, what is left:", *shown)


if __name__ == "__main__":
    main()
