"""The command that makes one take of several sensors' takes: ``merge``."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Column, Table
from tyro.conf import Positional, arg

from kinefilter.pipeline.config import TakeFormat

from .terminal import check_output, out, progress_bars, write_json

if TYPE_CHECKING:
    from kinefilter.pipeline.merge import Merged


@dataclass(frozen=True)
class Merge:
    """Make one take of what two or more sensors recorded of a person.

    Sensors stand still, at any angle to each other, with clocks of their own; nothing
    has to be calibrated. Lag and place of each are found from the motion itself. Every
    joint is fused from what the sensors saw of it: by its reliability, by how far a
    sensor sees the person from in front, and by whether the limb is on its side of the
    body. Takes may be of any format, skeleton and frame rate; those that do not show
    the same movement are refused.
    """

    takes: Positional[tuple[Path, ...]]
    """A take of each sensor; the first one's clock and frame are those of the merged
    take."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Take to write (.csv), with the reliability of each joint and the number of the
    sensor that has the largest share in it."""
    body: int | None = None
    """Which person of the first take, counted from 1; default: the one seen in most
    frames. Who that is in the other takes, and who is who after people pass each other
    or come back, is found by place, time and body lengths. Sensors that do not see the
    person are left out; for somebody whom only one sensor sees, name its take first."""
    calibration: Path | None = None
    """Where and when the sensors are, from --save-calibration of another take of the
    session: for takes in which people stand. It is refused if a sensor was moved."""
    save_calibration: Path | None = None
    """Write where and when the sensors are to this file (.json)."""
    format: TakeFormat | None = None
    """Layout of the takes; default: detected from the content of each."""
    json: Path | None = None
    """Write the printed figures to this file too."""

    def run(self) -> int:
        """Merge, write, print."""
        from kinefilter.pipeline.formats import read_recording
        from kinefilter.pipeline.formats.sheets import write_merged_csv
        from kinefilter.pipeline.merge import (
            merge,
            read_calibration,
            write_calibration,
        )

        written = (self.out, self.save_calibration, self.json)
        for k, path in enumerate(written):
            suffix = ".csv" if k == 0 else ""
            check_output(
                path, *self.takes, self.calibration, *written[:k], suffix=suffix
            )
        known = read_calibration(self.calibration)
        recordings = [read_recording(path, format=self.format) for path in self.takes]
        with progress_bars() as progress:
            merged = merge(
                recordings, body=self.body, calibration=known, progress=progress
            )
        write_merged_csv(merged.take, merged.reliability, merged.shares, self.out)
        if self.save_calibration is not None:
            write_calibration(merged, self.save_calibration)
        write_json(merged.figures(), self.json)
        out.print(_as_table(merged))
        for note in merged.told():
            out.print(note)
        out.print(
            f"wrote {', '.join(str(path) for path in written if path is not None)}"
        )
        return 0


def _as_table(merged: Merged) -> Table:
    sensor = Column("sensor", overflow="fold")  # what differs may be at the end
    table = Table(sensor, title=f"{len(merged.take)} frames merged")
    headings = ("lag, s", "ms a minute", "degrees", "m")
    for heading in (*headings, "share, %", "apart, cm"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in merged.figures()["sensors"]:
        apart = row["apart_meters"]
        table.add_row(
            Path(row["source"]).name,
            f"{row['lag_seconds']:.3f}",
            f"{60e3 * row['drift']:.1f}",
            f"{row['turned_degrees']:.1f}",
            f"{row['away_meters']:.2f}",
            f"{100.0 * row['share']:.0f}",
            "-" if isnan(apart) else f"{100.0 * apart:.1f}",
        )
    return table
