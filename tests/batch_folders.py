"""A folder with takes and other files, and what a batch made of it."""

from __future__ import annotations

import csv
from pathlib import Path

from batch_takes import short_take

from kinefilter import CleanConfig
from kinefilter.pipeline.batch.manifest import Row
from kinefilter.pipeline.batch.run import Outcome, clean_files
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.settings import Settings

QUICK = Settings(CleanConfig(method="none", physics=False))


def make_folder(folder: Path) -> Path:
    """Return a folder with three takes and what else lies in such folders."""
    (folder / "monday" / "late").mkdir(parents=True)
    for k, name in enumerate(("a", "monday/b", "monday/late/c")):
        write_take_csv(short_take(20 + k, seed=k), folder / f"{name}.csv")
    (folder / "notes.txt").write_text("what we did today\n")
    (folder / "labels.csv").write_text("take,label\na,wave\n")
    (folder / "about.json").write_text('{"studio": 4, "frames": 20}\n')
    (folder / "clip.npz").write_bytes(b"PK")
    (folder / ".hidden.csv").write_text("no take\n")
    return folder


def clean_folder(takes: Path, out: Path, settings: Settings = QUICK) -> Outcome:
    return clean_files([str(takes)], str(out), settings, suffix=".bvh")


def rows_of(out: Path) -> list[Row]:
    lines = (out / "manifest.jsonl").read_text().splitlines()
    return [Row.from_json(line) for line in lines]


def table_of(out: Path) -> list[dict[str, str]]:
    with (out / "manifest.csv").open(newline="") as file:
        return list(csv.DictReader(file))
