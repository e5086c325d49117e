"""Takes cut short, for tests that need a take but not all of its frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kinefilter.pipeline.pairs import PairedTake
from kinefilter.scenes import SAMPLE


def write_short_sample(folder: Path, frames: int = 60) -> Path:
    """Write the first frames of the sample, under its name, and return the file."""
    folder.mkdir(exist_ok=True)
    rows = SAMPLE.read_text(encoding="utf-8").splitlines(keepends=True)
    path = folder / SAMPLE.name
    path.write_text("".join(rows[: 1 + frames]), encoding="utf-8")
    return path


def beginning(pair: PairedTake, count: int = 60) -> PairedTake:
    """Return the first frames of a pair."""
    few = slice(count)
    return replace(pair, take=pair.take.at(few), truth=pair.truth[few])
