"""The figures that README and the lab's texts state, and whether they still hold.

``claims.toml`` lists them: ``says`` is how the row of the text's table begins, then
come the study, the row of its CSV and, by column, the figure exactly as printed (or
several rows, and as many figures in that order, separated by commas);
``where`` names the text unless it is README. A claim holds if the measured value ``is``
the figure, or is ``at most`` or ``at least`` that, up to a tolerance, ``within``, whose
reason is given as ``why``.
"""

import csv
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from rich.table import Table

from kinefilter.pipeline.formats import atomic_path

from .study import write_table

_LAST_DIGITS = 1.0  # half for rounding, half for differences between machines
_WHY = "rounding, and floating-point differences between machines"
_COLUMNS = ("claim", "README", "measured", "held")


@dataclass(frozen=True)
class Claim:
    """A figure stated in README or the lab's texts."""

    says: str
    figure: str  # as printed
    study: str
    row: str  # first cell of the row in the study's table
    column: str
    direction: Literal["is", "at most", "at least"]  # where the measured value may be
    within: float  # tolerance on the other side, in the figure's unit
    why: str  # reason for ``within``
    recordings: bool  # whether measuring it requires recordings
    where: str = "README.md"  # the text, or one of those in ``pipeline/lab``

    @property
    def name(self) -> str:
        """Study, row and column."""
        return f"{self.study} / {self.row} / {self.column}"

    def holds(self, measured: float) -> bool:
        """Return True if a measured value confirms the figure."""
        excess = measured - float(self.figure)
        excesses = {"is": abs(excess), "at most": excess, "at least": -excess}
        return excesses[self.direction] <= self.within


def read_claims() -> list[Claim]:
    """Return all claims, in the order of ``claims.toml``."""
    text = resources.files(__package__).joinpath("claims.toml").read_text("utf-8")
    claims = []
    for entry in tomllib.loads(text)["claim"]:
        rows = entry.pop("row")
        rows = [rows] if isinstance(rows, str) else rows
        for column, listed in entry.pop("cells").items():
            for row, figure in zip(rows, listed.split(", "), strict=True):
                settings = {
                    "direction": "is",
                    "within": _LAST_DIGITS * last_digit(figure),
                    "why": _WHY,
                    "recordings": column.startswith("recorded"),
                    **entry,
                }
                claims.append(Claim(figure=figure, row=row, column=column, **settings))
    return claims


def last_digit(figure: str) -> float:
    """Return the value of one unit in the last place of a printed figure."""
    return 10.0 ** -len(figure.partition(".")[2])


@dataclass(frozen=True)
class Verdict:
    """A claim and the measured value."""

    claim: Claim
    measured: float | None  # None if the study has no such figure
    held: bool | None  # None if not judged, for the reason in note
    note: str = ""

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Cells of the verdict's row in a table."""
        measured = "" if self.measured is None else f"{self.measured:.4g}"
        held = self.note if self.held is None else "yes" if self.held else "no"
        return self.claim.name, self.claim.figure, measured, held


def judge(
    folder: Path, studies: Collection[str], *, recordings: bool, quick: bool = False
) -> list[Verdict]:
    """Compare the claims of some studies with the tables that they wrote to a folder.

    Claims that need recordings are judged with ``recordings`` only; ``quick`` studies
    of a small part of everything decide none.
    """
    tables = {name: _cells(folder / f"{name}.csv") for name in studies}
    verdicts = []
    for claim in read_claims():
        if claim.study not in studies:
            continue
        cell = tables[claim.study].get((claim.row, claim.column), "")
        measured = float(cell) if cell else None
        if claim.recordings and not recordings:
            verdicts.append(Verdict(claim, None, None, "not measured: no recordings"))
        elif quick:  # rows may be missing, too
            verdicts.append(Verdict(claim, measured, None, "not judged: --quick"))
        else:
            held = measured is not None and claim.holds(measured)
            verdicts.append(Verdict(claim, measured, held))
    return verdicts


def _cells(path: Path) -> dict[tuple[str, str], str]:
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return {
        (row[0], column): cell
        for row in rows
        for column, cell in zip(head, row, strict=True)
    }


def write_verdicts(verdicts: Sequence[Verdict], folder: Path) -> Path:
    """Write ``claims.csv`` into a folder and return its path."""
    path = folder / "claims.csv"
    rows = [(*_COLUMNS, "direction", "within", "why")]
    for verdict in verdicts:
        claim = verdict.claim
        rows.append((*verdict.row, claim.direction, f"{claim.within:g}", claim.why))
    with atomic_path(path) as temporary:
        write_table(rows, temporary)
    return path


def verdicts_table(verdicts: Sequence[Verdict]) -> Table:
    """Return a table of the verdicts for a terminal."""
    judged = [verdict.held for verdict in verdicts if verdict.held is not None]
    title = f"{sum(judged)} of {len(judged)} claims held"
    if len(judged) < len(verdicts):
        title += f", {len(verdicts) - len(judged)} not judged"
    table = Table(*_COLUMNS, title=title, title_justify="left")
    for verdict in verdicts:
        table.add_row(*verdict.row, style="red" if verdict.held is False else None)
    return table
