"""What README says in figures, and whether the studies still find it.

``claims.toml`` has them: the words that the row of README's table begins with, the
study and the row of its CSV, and for each column the figure exactly as README prints
it. A claim is kept if what is measured ``is`` that figure, or is ``at most`` or ``at
least`` that, ``within`` what is given with its reason.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from rich.table import Table

from kinefilter.pipeline.formats import atomic_path

__all__ = [
    "Claim",
    "Verdict",
    "judge",
    "read_claims",
    "verdicts_table",
    "write_verdicts",
]

_UNITS = (
    1.0  # of the last digit: half for rounding, half for other machines' arithmetic
)
_WHY = "rounding, and the arithmetic of other machines"


@dataclass(frozen=True)
class Claim:
    """One figure of README."""

    says: str
    """What README's row begins with."""
    figure: str
    """The figure as README prints it."""
    study: str
    """One of STUDIES."""
    row: str
    """First cell of the study's row."""
    column: str
    """Name of the study's column."""
    direction: Literal["is", "at most", "at least"]
    """On which side of the figure what is measured may be."""
    within: float
    """How far on the other side it may be, in the figure's unit."""
    why: str
    """Reason for ``within``."""
    recordings: bool
    """Only recordings can tell."""

    @property
    def name(self) -> str:
        """What the claim is called."""
        return f"{self.study} / {self.row} / {self.column}"

    def holds(self, measured: float) -> bool:
        """Return whether a measured value is what README says."""
        away = measured - float(self.figure)
        if self.direction == "at most":
            return away <= self.within
        if self.direction == "at least":
            return away >= -self.within
        return abs(away) <= self.within


@dataclass(frozen=True)
class Verdict:
    """A claim and what was found."""

    claim: Claim
    measured: float | None
    """None: there is no such figure."""
    held: bool | None
    """None: not judged."""
    note: str = ""
    """Why it is not judged."""

    @property
    def words(self) -> str:
        """What a table says of it."""
        return self.note if self.held is None else "yes" if self.held else "no"


def read_claims() -> list[Claim]:
    """Return the figures of README, in its order."""
    text = resources.files(__package__).joinpath("claims.toml").read_text("utf-8")
    return [
        claim for entry in tomllib.loads(text)["claim"] for claim in _claims_of(entry)
    ]


def _claims_of(entry: dict[str, Any]) -> list[Claim]:
    return [
        Claim(
            says=entry["says"],
            figure=figure,
            study=entry["study"],
            row=entry["row"],
            column=column,
            direction=entry.get("direction", "is"),
            within=entry.get("within", _UNITS * last_digit(figure)),
            why=entry.get("why", _WHY),
            recordings=entry.get("recordings", column.startswith("recorded")),
        )
        for column, figure in entry["cells"].items()
    ]


def last_digit(figure: str) -> float:
    """Return what a one in the last place of a printed figure stands for."""
    return 10.0 ** -len(figure.partition(".")[2])


def judge(folder: Path, *, recordings: bool, quick: bool = False) -> list[Verdict]:
    """Compare every claim with the studies' tables in a folder.

    Args:
        folder: Where ``NAME.csv`` of the studies are.
        recordings: Whether the studies had recordings.
        quick: Whether they took a small part of everything, which judges nothing.
    """
    claims = read_claims()
    tables = {
        name: _cells(folder / f"{name}.csv") for name in {c.study for c in claims}
    }
    return [_judged(claim, tables[claim.study], recordings, quick) for claim in claims]


def _judged(
    claim: Claim, cells: dict[tuple[str, str], str], recordings: bool, quick: bool
) -> Verdict:
    if claim.recordings and not recordings:
        return Verdict(claim, None, None, "not measured: no recordings")
    cell = cells.get((claim.row, claim.column), "")
    if not cell:
        return Verdict(claim, None, False)
    measured = float(cell)
    if quick:
        return Verdict(claim, measured, None, "not judged: --quick")
    return Verdict(claim, measured, claim.holds(measured))


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


_COLUMNS = ("claim", "README", "measured", "held")


def write_verdicts(verdicts: Sequence[Verdict], folder: Path) -> Path:
    """Write ``claims.csv`` into a folder and return its path."""
    path = folder / "claims.csv"
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*_COLUMNS, "direction", "within", "why"))
        for verdict in verdicts:
            claim = verdict.claim
            more = (claim.direction, f"{claim.within:g}", claim.why)
            writer.writerow((*_row(verdict), *more))
    return path


def verdicts_table(verdicts: Sequence[Verdict]) -> Table:
    """Return the claims for a terminal."""
    judged = [verdict for verdict in verdicts if verdict.held is not None]
    held = sum(verdict.held is True for verdict in judged)
    title = f"{held} of {len(judged)} claims of README held"
    if len(judged) < len(verdicts):
        title += f", {len(verdicts) - len(judged)} not judged"
    table = Table(*_COLUMNS, title=title, title_justify="left")
    for verdict in verdicts:
        table.add_row(*_row(verdict), style="red" if verdict.held is False else None)
    return table


def _row(verdict: Verdict) -> tuple[str, str, str, str]:
    measured = "" if verdict.measured is None else f"{verdict.measured:.4g}"
    claim = verdict.claim
    return claim.name, claim.figure, measured, verdict.words
