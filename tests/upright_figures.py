"""Choose how a sensor's tilt is found on some people, and tell on others how it does.

    python tests/upright_figures.py ../shared/data

Recordings are turned by known angles. Told is by how many degrees the vertical is then
off what it was in the recording: where nothing is done, where every take is turned by
what is measured in it, with the limits as chosen on half of the people, and with those
in ``pipeline/upright.py``. Chosen is what leaves the fewest degrees without
turning any take as it was recorded; but arms that hang are asked for whatever it costs,
as nobody in the recordings is on their hands. For pairs also E of the clip [cm],
against mocap.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, Skeleton, Take
from kinefilter.characters.rotations import unit
from kinefilter.pipeline import upright
from kinefilter.pipeline.formats.mocap import (
    RIGS,
    KinectMotion,
    kinect_motion,
    read_mocap,
)
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.target.floor import leveled
from kinefilter.pipeline.upright import Turn

Array = NDArray[np.float64]
UP = np.array([0.0, 1.0, 0.0])
TURNS = {
    "level": [("x", 0.0)],
    **{f"pitch {a}": [("x", a), ("x", -a)] for a in (10, 20, 30)},
    **{f"roll {a}": [("z", a), ("z", -a)] for a in (10, 20, 30)},
    "upside down": [("z", 180.0)],
}
GRID = {
    "_MIN_SHARE": [0.1, 0.2, 0.25, 0.3, 0.5],
    "_SIMILAR": np.cos(np.radians([10.0, 15.0, 20.0, 30.0])),
    "_AGREEMENT": [0.5, 0.6, 0.7, 0.8, 0.9],
}
LIMITS = ("both", "either", *GRID)
_MARGIN = 1.5  # times the largest lean of the people that are chosen on
_METHODS = ("nothing", "always", "chosen", "shipped")
_MOST_FRAMES = 3000
_say = Console(soft_wrap=True, highlight=False, width=110).print


@dataclass(frozen=True, eq=False)
class Bearing:
    """How the person of a take bears themselves, which can be turned."""

    along: Array
    straight: NDArray[np.bool_]
    down: Array

    @classmethod
    def of(cls, take: Take | KinectMotion, skeleton: Skeleton = KINECT_V1) -> Bearing:
        """Measure it in a take."""
        some = take.positions[:: 1 + len(take.positions) // _MOST_FRAMES]
        return cls(*upright._posture(some, skeleton))

    def turn(self, matrix: Array) -> Turn:
        """Return what is found once the take is turned by a matrix."""
        along = self.along @ matrix.T
        return upright._turn_from(along, self.straight, self.down, upright._MIN_FRAMES)

    def unturned(self, _: Array) -> Turn:
        """Return no turn, whatever is found."""
        return Turn()

    def measured(self, matrix: Array) -> Turn:
        """Return the whole turn from the median to the vertical, whatever it is."""
        stands = self.straight.any(axis=1)
        along = self.along[stands] if stands.any() else self.along
        up = matrix @ unit(np.median(along, axis=0))
        roll = np.arctan2(up[0], up[1])
        return Turn(float(roll), -float(np.arctan2(up[2], np.hypot(up[0], up[1]))))


_FINDS = {"nothing": Bearing.unturned, "always": Bearing.measured}


def matrices(name: str) -> list[Array]:
    """Return the rotations of a row of the table."""
    turns = [Rotation.from_euler(a, d, degrees=True) for a, d in TURNS[name]]
    return [turn.as_matrix() for turn in turns]


def left(turn: Turn, matrix: Array) -> float:
    """Return by how many degrees the vertical is off after a rotation and a turn."""
    found = leveled(matrix @ UP, turn.tilt, turn.roll)
    return float(np.degrees(np.arccos(np.clip(found[1], -1.0, 1.0))))


def all_left(
    found: list[Bearing],
    name: str,
    find: Callable[[Bearing, Array], Turn] = Bearing.turn,
) -> list[float]:
    """Return the degrees left of all takes in a row of the table."""
    return [left(find(b, m), m) for m in matrices(name) for b in found]


def bearings(data: Path, half: int) -> list[Bearing]:
    """Return those of half of the people: 0 to choose on, 1 to tell on."""
    found = [Bearing.of(pair.take) for pair in pairs(data, half)]
    for path in of_half(sorted(data.glob("two-kinects/*_[AB]*.csv.gz")), half, 3):
        found.append(Bearing.of(read_take(path), KINECT_V2))
    for path in of_half(sorted(data.glob("takes/precog16/*.csv.gz")), half, 4):
        try:
            found.append(Bearing.of(read_take(path)))
        except InputError:
            continue  # some are zero from end to end
    for path in of_half(sorted(data.glob("mocap/cmu/*.bvh.gz")), half, 2):
        motion = kinect_motion(read_mocap(path), KINECT_V1, RIGS)
        found.append(Bearing.of(motion))
    return [bearing for bearing in found if len(bearing.along)]


def of_half(paths: list[Path], half: int, letters: int) -> Iterator[Path]:
    """Yield the files of every other person: those whose names begin alike."""
    people = sorted({path.name[:letters] for path in paths})
    return (p for p in paths if people.index(p.name[:letters]) % 2 == half)


def pairs(data: Path, half: int) -> list[PairedTake]:
    """Return the pairs of three of six people."""
    files = sorted(data.glob("ui-prmd/s*.npz"))
    middle = len(files) // 2
    return [p for f in (files[:middle], files[middle:])[half] for p in read_pairs(f)]


def limit(name: str, value: float | None = None) -> float:
    """Return a limit, having set it to a value."""
    if name in upright._ORDINARY:
        if value is not None:
            upright._ORDINARY[name] = value
        return upright._ORDINARY[name]
    if value is not None:
        setattr(upright, name, value)
    return getattr(upright, name)


def cost(found: list[Bearing]) -> float:
    """Return the mean of degrees left, infinite if a take as recorded is turned."""
    turns = [b.turn(np.eye(3)) for b in found]
    if any(turn != replace(Turn(), doubt=turn.doubt) for turn in turns):
        return np.inf
    return float(np.mean([np.mean(all_left(found, name)) for name in TURNS]))


def choose(found: list[Bearing]) -> dict[str, float]:
    """Return limits: half again the largest lean, and the others of least cost.

    One after the other, twice, beginning with those that are shipped; they stay where
    another is no better.
    """
    for name in ("both", "either"):
        limit(name, np.pi)
    for name, straight in (("both", np.all), ("either", np.any)):
        leans = [
            np.arccos(unit(np.median(b.along[stands], axis=0))[1])
            for b in found
            if (stands := straight(b.straight, axis=1)).mean() >= limit("_MIN_SHARE")
        ]
        limit(name, _MARGIN * max(leans))
    for _ in range(2):
        for name, values in GRID.items():
            best, least = limit(name), cost(found)
            for value in values:
                limit(name, float(value))
                if (now := cost(found)) < least - 1e-9:
                    best, least = float(value), now
            limit(name, best)
    return {name: limit(name) for name in LIMITS}


def accuracy(data: Path) -> Iterator[tuple[str, list[float]]]:
    """Yield E [cm] of clips of turned takes of the other half by each method."""
    told = [p for p in pairs(data, 1) if p.clip.endswith("e05")]
    config = CleanConfig(method="local-pca")
    measure = Accuracy(KINECT_V1)
    for name in TURNS:
        errors: dict[str, list[float]] = {}
        for pair in told:
            matrix = matrices(name)[0]
            turned = replace(pair.take, positions=pair.take.positions @ matrix.T)
            whole = Bearing.of(pair.take).measured(matrix)
            upright_take = leveled(turned.positions, whole.tilt, whole.roll)
            level = replace(config, tilt=0.0)
            whole_turn = replace(turned, positions=upright_take)
            tries = {
                "nothing": (turned, level),
                "always": (whole_turn, level),
                "shipped": (turned, config),
            }
            for method, (take, how) in tries.items():
                away = measure.distances(clean(take, how).clip.positions, pair.truth)
                error = 100.0 * float(np.nanmean(away))
                errors.setdefault(method, []).append(error)
        yield name, [float(np.mean(e)) for e in errors.values()]


def use(limits: dict[str, float]) -> None:
    """Set limits."""
    for name, value in limits.items():
        limit(name, value)


def told(
    found: list[Bearing], chosen: dict[str, float], shipped: dict[str, float]
) -> Table:
    """Return the table of degrees left: their mean, and the takes under 10 degrees."""
    table = Table(f"degrees left (% under 10), {len(found)} others", *_METHODS)
    for name in TURNS:
        cells = []
        for method in _METHODS:
            use(chosen if method == "chosen" else shipped)
            rest = np.array(all_left(found, name, _FINDS.get(method, Bearing.turn)))
            cells.append(f"{rest.mean():.1f} ({100.0 * np.mean(rest < 10.01):.0f})")
        table.add_row(name, *cells)
    return table


def main() -> int:
    """Choose, tell, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--no-clips", action="store_true", help="no E of clips")
    asked = parser.parse_args()
    shipped = {name: limit(name) for name in LIMITS}
    halves = [bearings(asked.data, half) for half in (0, 1)]
    for first, other in (halves, halves[::-1]):
        chosen = choose(first)
        limits = Table("limit", "shipped", f"chosen on {len(first)} takes")
        for name, value in shipped.items():
            limits.add_row(name, *(f"{v:.3f}" for v in (value, chosen[name])))
        _say(limits)
        _say(told(other, chosen, shipped))
        use(shipped)
    if not asked.no_clips:
        table = Table("E of clips, cm", "nothing", "always", "shipped")
        for name, row in accuracy(asked.data):
            table.add_row(name, *(f"{e:.1f}" for e in row))
        _say(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
