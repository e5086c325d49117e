"""``kinefilter reproduce``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Table
from tyro.conf import Positional, arg

from .terminal import out, progress_bars

if TYPE_CHECKING:
    from kinefilter.pipeline.studies import Bar

__all__ = ["Reproduce"]


@dataclass(frozen=True)
class Reproduce:
    """Repeat the studies of the papers on simulated takes: a table and a plot each."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder to write STUDY.csv and STUDY.png into; made if it is missing."""
    studies: Positional[tuple[str, ...]] = ()
    """shum-table-3, shum-table-4, shum-figure-8, liu-figure-3, liu-figure-7,
    liu-table-5, chiang-figure-5, reliability; default: all, in some five minutes."""
    seed: int = 0
    """Draws people, performances and the sensor's errors."""
    quick: bool = False
    """Take a small part of everything, to see how it works; figures mean little."""

    def run(self) -> int:
        """Study, write, print."""
        from kinefilter.pipeline.studies import (
            STUDIES,
            as_table,
            check_drawing,
            check_names,
            check_studies_folder,
            reproduce,
            write_study,
        )

        names = self.studies or tuple(STUDIES)
        check_names(names)
        check_drawing()
        check_studies_folder(self.out)
        bars: list[Bar] = []
        for name in names:
            with progress_bars() as progress:
                study = reproduce(
                    name, seed=self.seed, quick=self.quick, progress=progress
                )
            written = write_study(study, self.out)
            out.print(as_table(study))
            out.print(f"wrote {' and '.join(map(str, written))}\n", markup=False)
            bars += study.bars
        if bars:
            out.print(_held(bars))
        return 0


def _held(bars: Sequence[Bar]) -> Table:
    """Return which targets were reached."""
    held = sum(bar.held for bar in bars)
    table = Table(
        "figure",
        "measured",
        "target",
        "held",
        title=f"{held} of {len(bars)} bars held",
        title_justify="left",
    )
    for bar in bars:
        target = f"{'at most' if bar.at_most else 'at least'} {bar.target:g}"
        table.add_row(
            bar.what, f"{bar.measured:.2f}", target, "yes" if bar.held else "no"
        )
    return table
