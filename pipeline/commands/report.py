"""``kinefilter report``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from .terminal import err, keep, out


@dataclass(frozen=True)
class Report:
    """Show a clip beside its take in one web page, which needs no network.

    Raw and clean play side by side over reliability and origin of every joint,
    contacts, distances moved, and the metrics, passed or failed. clean --report writes
    it too.
    """

    clip: Positional[Path]
    """Clip: .npz, USD, .bvh or .csv."""
    take: Path
    """The take that the clip was made of."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """Page to write, .html."""
    body: int | None = None
    """Which person of the take, counted from 1; default: who is seen in most
    frames."""
    thresholds: Path | None = None
    """TOML file of limits, as fail_on = ["skate > 0.003"]; default: those that ship
    with kinefilter. They color the table of metrics."""
    fail_on: UseAppendAction[tuple[str, ...]] = ()
    """A limit, as skate>0.003 (quoted, for the shell); beyond it, exit code 1. May be
    given several times."""

    def run(self) -> int:
        """Compare, write, say what failed."""
        from kinefilter.pipeline.look import (
            check_report,
            parse_limit,
            read_comparison,
            read_limits,
            write_report,
        )

        check_report(self.out)
        keep(self.out, self.clip, self.take, self.thresholds)
        gates = [parse_limit(text) for text in self.fail_on]
        limits = read_limits(self.thresholds)
        comparison = read_comparison(self.clip, self.take, body=self.body)
        # A gate that is a threshold too stands once in the table.
        write_report(comparison, self.out, tuple(dict.fromkeys((*limits, *gates))))
        out.print(f"wrote {self.out}")
        failed = [gate for gate in gates if gate.fails(comparison.after)]
        for gate in failed:
            value = comparison.after[gate.metric]
            err.print(f"kinefilter: failed {gate}: it is {value:.4g}")
        return 1 if failed else 0
