"""What a study found: a table and a plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.table import Table

Cell = str | int | float | None
"""Of a table; None is an empty cell."""


@dataclass(frozen=True)
class Series:
    """One line of a plot, or one color of bars."""

    label: str
    """What the legend says."""
    x: Sequence[float] | Sequence[str]
    """Places along the axis; for bars the names of the groups."""
    y: Sequence[float]
    """Values; for a level a single one."""
    kind: Literal["line", "bars", "level"] = "line"
    """A level is a horizontal line through the whole panel."""
    paper: bool = False
    """The paper's own figures, not ours."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    x_label: str
    """What is varied, with its unit."""
    y_label: str
    """What is measured, with its unit."""
    series: tuple[Series, ...]
    """What is drawn."""
    log_x: bool = False
    """The axis of what is varied is logarithmic."""
    log_y: bool = False
    """The axis of what is measured is logarithmic."""
    zero: bool = True
    """The axis of what is measured begins at 0, unless it is logarithmic."""


@dataclass(frozen=True)
class Study:
    """The result of one study."""

    name: str
    """As on the command line."""
    title: str
    """What was studied, and where the paper has it."""
    columns: tuple[str, ...]
    """Names of the columns; those of the paper's figures begin with ``paper``."""
    rows: tuple[tuple[Cell, ...], ...]
    """The table."""
    panels: tuple[Panel, ...]
    """The plot, row by row."""
    across: int = 1
    """Panels in a row of the plot."""


def as_table(study: Study) -> Table:
    """Return the study's table for a terminal."""
    table = Table(title=study.title, title_justify="left")
    for k, column in enumerate(study.columns):
        numbers = any(isinstance(row[k], int | float) for row in study.rows)
        # A word a line: a table of ten columns is to fit 80 characters.
        heading = column.replace("_", "\n").replace("percent", "%")
        table.add_column(heading, justify="right" if numbers else "left")
    for row in study.rows:
        table.add_row(*(as_text(cell) for cell in row))
    return table


def as_text(cell: Cell) -> str:
    """Return a cell's text for a terminal: four digits are enough."""
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)
