"""Which claims of README held: told in a table, and written beside the studies."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from kinefilter.pipeline.formats import atomic_path

from .claims import Claim, read_claims

_COLUMNS = ("claim", "README", "measured", "held")


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
    measured = float(cell) if cell else None
    if quick:  # which leaves out rows, too
        return Verdict(claim, measured, None, "not judged: --quick")
    if measured is None:
        return Verdict(claim, None, False)
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
