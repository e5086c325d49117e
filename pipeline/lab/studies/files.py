"""A study on disk: its table as CSV and its plot as PNG, both or none."""

from __future__ import annotations

import csv
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.formats import atomic_path

from .drawing import draw
from .study import Study


def check_studies_folder(folder: Path) -> None:
    """Raise an InputError if studies cannot be written into a folder, new or not."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; give a folder to write to")
    if not folder.exists() and not folder.parent.is_dir():
        raise InputError(
            f"{folder}: folder {folder.parent} does not exist; create it or write "
            "elsewhere"
        )


def write_study(study: Study, folder: Path) -> tuple[Path, Path]:
    """Write ``NAME.csv`` and ``NAME.png`` into a folder, and return their paths.

    Older files stay as they were until both new ones are whole.

    Raises:
        InputError: The folder cannot be written to, or matplotlib is not installed.
    """
    check_studies_folder(folder)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{folder}: cannot be made ({reason})") from error
    table, plot = folder / f"{study.name}.csv", folder / f"{study.name}.png"
    with atomic_path(table) as new_table, atomic_path(plot) as new_plot:
        _write_table(study, new_table)
        draw(study, new_plot)
    return table, plot


def _write_table(study: Study, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(study.columns)
        writer.writerows(
            [f"{cell:.6g}" if isinstance(cell, float) else cell for cell in row]
            for row in study.rows
        )
