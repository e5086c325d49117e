"""Input and output of a study: options in, a table and a plot out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.table import Table

from kinefilter.pipeline.progress import Progress, silent

Cell = str | int | float | None  # of a table; None if it is empty
Row = tuple[Cell, ...]
Kind = Literal["line", "bars", "level"]  # a level is a line across the panel


@dataclass(frozen=True)
class Options:
    """Settings common to all studies."""

    seed: int = 0  # seed of simulated people, performances and sensor errors
    data: Path | None = None  # folder of recordings; None: simulated takes only
    progress: Progress = silent  # wraps the loops, for a progress bar


@dataclass(frozen=True)
class Series:
    """One line of a plot, or one color of bars."""

    label: str  # in the legend; figures of the paper begin with paper
    x: Sequence[float] | Sequence[str]  # for bars, the names of the groups
    y: Sequence[float]  # values; a single one for a level
    kind: Kind = "line"


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    x_label: str  # what is varied, with its unit
    y_label: str  # what is measured, with its unit
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    zero: bool = True  # whether a linear y axis begins at 0


@dataclass(frozen=True)
class Study:
    """The result of one study."""

    title: str  # the topic, and where the paper covers it
    columns: Sequence[str]  # those of the paper's figures begin with paper
    rows: Sequence[Sequence[Cell]]
    panels: Sequence[Panel]  # the plot, row by row
    across: int = 1  # number of panels side by side


def series_of(
    rows: Sequence[Sequence[Cell]],
    columns: Mapping[str, int],
    *,
    x: int | Sequence[str] = 0,
    kind: Kind = "line",
) -> list[Series]:
    """Return a series for each entry of ``columns``, a label and a column number.

    ``x`` is the number of the column with the positions along the axis (for bars, the
    names of the groups), or those names themselves.
    """

    def numbers(column: int) -> list[float]:
        return [float(row[column] or 0.0) for row in rows]

    along: Sequence[float] | Sequence[str]
    if isinstance(x, int):
        along = [str(row[x]) for row in rows] if kind == "bars" else numbers(x)
    else:
        along = x
    return [Series(label, along, numbers(k), kind) for label, k in columns.items()]


def as_table(study: Study) -> Table:
    """Return the study's table for a terminal, with numbers to four digits."""
    table = Table(title=study.title, title_justify="left")
    for k, column in enumerate(study.columns):
        numeric = any(isinstance(row[k], int | float) for row in study.rows)
        # One word per line, so that ten columns fit into 80 characters.
        heading = column.replace("_", "\n").replace("percent", "%")
        table.add_column(heading, justify="right" if numeric else "left")
    for row in study.rows:
        cells = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row)
        table.add_row(*("" if cell is None else str(cell) for cell in cells))
    return table
