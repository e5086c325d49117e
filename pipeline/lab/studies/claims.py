"""What README says in figures, and whether the studies still find it.

``claims.toml`` has them: the words that the row of README's table begins with, the
study and the row of its CSV, and for each column the figure exactly as README prints
it. A claim is kept if what is measured ``is`` that figure, or is ``at most`` or ``at
least`` that, ``within`` what is given with its reason.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

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
