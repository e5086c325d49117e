"""README's figures as claims, and whether the studies still find them.

``claims.toml`` lists them: the words that a row of README's table begins with, the
study and the row of its CSV, and for each column the figure exactly as README prints
it; with ``where``, the text is another. A claim holds if what is measured ``is`` that
figure, or is ``at most`` or ``at least`` that, ``within`` a tolerance that is given
with its reason.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from rich.table import Table

from kinefilter.pipeline.formats import atomic_path

from .output import write_table

_LAST_DIGITS = 1.0  # half for rounding, half for the arithmetic of other machines
_WHY = "rounding, and the arithmetic of other machines"
_COLUMNS = ("claim", "README", "measured", "held")


@dataclass(frozen=True)
class Claim:
    """A figure of README or the lab's texts, with what ``claims.toml`` says of it."""

    says: str
    figure: str
    """As it is printed there."""
    study: str
    row: str
    """First cell of the row in the study's table."""
    column: str
    direction: Literal["is", "at most", "at least"]
    """On which side of the figure the measured value may be."""
    within: float
    """How far on the other side it may be, in the figure's unit."""
    why: str
    """Reason for ``within``."""
    recordings: bool
    """Whether it takes recordings to measure it."""
    where: str = "README.md"
    """Which text states it; the others are ``RESULTS.md`` and ``DEPARTURES.md`` of
    ``pipeline/lab``."""

    @property
    def name(self) -> str:
        """Study, row and column."""
        return f"{self.study} / {self.row} / {self.column}"

    def holds(self, measured: float) -> bool:
        """Return whether a measured value is what README says."""
        away = measured - float(self.figure)
        beyond = {"is": abs(away), "at most": away, "at least": -away}
        return beyond[self.direction] <= self.within


def read_claims() -> list[Claim]:
    """Return the figures that are claimed, in their order."""
    text = resources.files(__package__).joinpath("claims.toml").read_text("utf-8")
    claims = []
    for entry in tomllib.loads(text)["claim"]:
        for column, figure in entry.pop("cells").items():
            common = {
                "direction": "is",
                "within": _LAST_DIGITS * last_digit(figure),
                "why": _WHY,
                "recordings": column.startswith("recorded"),
                **entry,
            }
            claims.append(Claim(figure=figure, column=column, **common))
    return claims


def last_digit(figure: str) -> float:
    """Return what a one in the last place of a printed figure stands for."""
    return 10.0 ** -len(figure.partition(".")[2])


@dataclass(frozen=True)
class Verdict:
    """A claim and what was measured."""

    claim: Claim
    measured: float | None
    """None: the study has no such figure."""
    held: bool | None
    """None: not judged, for the reason in ``note``."""
    note: str = ""

    @property
    def words(self) -> str:
        """The last cell of the verdict's row in a table."""
        return self.note if self.held is None else "yes" if self.held else "no"

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Cells of the verdict's row in a table."""
        measured = "" if self.measured is None else f"{self.measured:.4g}"
        return self.claim.name, self.claim.figure, measured, self.words


def judge(folder: Path, *, recordings: bool, quick: bool = False) -> list[Verdict]:
    """Compare every claim with the studies' tables in a folder.

    Args:
        folder: Where ``NAME.csv`` of the studies are.
        recordings: Whether the studies had recordings.
        quick: Whether the studies were run with ``--quick``; then nothing is judged.
    """
    claims = read_claims()
    tables = {
        name: _cells(folder / f"{name}.csv") for name in {c.study for c in claims}
    }
    verdicts = []
    for claim in claims:
        cell = tables[claim.study].get((claim.row, claim.column), "")
        measured = float(cell) if cell else None
        if claim.recordings and not recordings:
            verdict = Verdict(claim, None, None, "not measured: no recordings")
        elif quick:  # which leaves out rows, too
            verdict = Verdict(claim, measured, None, "not judged: --quick")
        else:
            held = measured is not None and claim.holds(measured)
            verdict = Verdict(claim, measured, held)
        verdicts.append(verdict)
    return verdicts


def _cells(path: Path) -> dict[tuple[str, str], str]:
    """Return the cells of a study's table by row and column; none without a file."""
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
    rows = [
        (*one.row, one.claim.direction, f"{one.claim.within:g}", one.claim.why)
        for one in verdicts
    ]
    path = folder / "claims.csv"
    with atomic_path(path) as temporary:
        write_table([(*_COLUMNS, "direction", "within", "why"), *rows], temporary)
    return path


def verdicts_table(verdicts: Sequence[Verdict]) -> Table:
    """Return the verdicts for a terminal."""
    judged = [verdict.held for verdict in verdicts if verdict.held is not None]
    title = f"{sum(judged)} of {len(judged)} claims held"
    if len(judged) < len(verdicts):
        title += f", {len(verdicts) - len(judged)} not judged"
    table = Table(*_COLUMNS, title=title, title_justify="left")
    for verdict in verdicts:
        table.add_row(*verdict.row, style="red" if verdict.held is False else None)
    return table
