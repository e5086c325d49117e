"""The command ``merge``."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Column, Table
from tyro.conf import Positional, arg

from kinefilter.pipeline.config import TakeFormat

from .terminal import check_output, check_outputs, out, progress_bars, write_json

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged


@dataclass(frozen=True)
class Merge:
    """Merge simultaneous takes of a person by two or more sensors into one take.

    The sensors must not move during the take, but may stand at any angle to each other
    with independent clocks; no calibration is needed. The lag and the placement of each
    are found from the motion itself. Each joint is a weighted mean over the sensors:
    weights depend on its reliability, on how frontally the sensor sees the person, and
    on whether the limb is on the sensor's side of the body. Takes may have any format,
    skeleton and frame rate; takes that do not show the same movement are refused.
    """

    takes: Positional[tuple[Path, ...]]
    """One take per sensor; the merged take uses the clock and the frame of reference of
    the first."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Take to write (.csv), with the reliability of each joint and the number of the
    sensor with the largest share in it."""
    body: int | None = None
    """Number of the person in the first take, from 1; default: the one seen in most
    frames. The same person in the other takes, and after people pass each other or
    return, is identified by place, time and body lengths. Sensors that do not see the
    person are left out; for a person seen by one sensor only, give its take first."""
    calibration: Path | None = None
    """Calibration from --save-calibration of another take with the sensors in the same
    places, needed for takes in which the person does not walk around. It is refused if
    a sensor was moved."""
    save_calibration: Path | None = None
    """Also write the placement and lag of the sensors to this file (.json)."""
    format: TakeFormat | None = None
    """Format of the takes; default: detected from the content of each."""
    json: Path | None = None
    """Also write the printed figures to this JSON file."""

    def run(self) -> int:
        """Merge the takes, write the result, and print a summary."""
        from kinefilter.pipeline.formats import read_recording
        from kinefilter.pipeline.formats.sheets import write_merged_csv
        from kinefilter.pipeline.merge import merge, read_calibration, write_calibration

        written = (self.out, self.save_calibration, self.json)
        check_output(self.out, suffix=".csv")
        check_outputs(written, *self.takes, self.calibration)
        known = read_calibration(self.calibration)
        recordings = [read_recording(path, format=self.format) for path in self.takes]
        with progress_bars() as bars:
            merged = merge(recordings, body=self.body, calibration=known, progress=bars)
        write_merged_csv(merged.take, merged.reliability, merged.shares, self.out)
        if self.save_calibration is not None:
            write_calibration(merged, self.save_calibration)
        write_json(merged.figures(), self.json)
        out.print(_as_table(merged))
        for note in merged.all_notes():
            out.print(note)
        out.print(f"wrote {', '.join(str(path) for path in written if path)}")
        return 0


def _as_table(merged: Merged) -> Table:
    sensor = Column("sensor", overflow="fold")  # names may differ only at the end
    table = Table(sensor, title=f"{len(merged.take)} frames merged")
    headings = ("lag, s", "drift, ms/min", "angle, deg", "distance, m")
    for heading in (*headings, "share, %", "residual, cm"):  # two lines leave room
        table.add_column(heading.replace(" ", "\n"), justify="right", no_wrap=True)
    for row in merged.figures()["sensors"]:
        residual = row["apart_meters"]
        table.add_row(
            Path(row["source"]).name,
            f"{row['lag_seconds']:.3f}",
            f"{60e3 * row['drift']:.1f}",
            f"{row['turned_degrees']:.1f}",
            f"{row['away_meters']:.2f}",
            f"{100.0 * row['share']:.0f}",
            "-" if isnan(residual) else f"{100.0 * residual:.1f}",
        )
    return table
