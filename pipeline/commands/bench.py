"""``kinefilter bench``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .terminal import keep, out, write_json


@dataclass(frozen=True)
class Bench:
    """Time every stage frame by frame, a live frame in all, and whole takes."""

    take: Path | None = None
    """Take to time on; default: the sample that comes with kinefilter."""
    json: Path | None = None
    """Write the figures to this file too."""

    def run(self) -> int:
        """Time and print."""
        from kinefilter.pipeline.formats import check_folder
        from kinefilter.pipeline.lab.bench import as_table, bench

        if self.json is not None:
            check_folder(self.json)
            keep(self.json, self.take)
        figures = bench(self.take)
        if self.json is not None:
            write_json(figures, self.json)
        out.print(as_table(figures))
        return 0
