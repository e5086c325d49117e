"""The figures of README and of the papers, measured: one table and plot per study.

A study is a function of ``Options`` and sizes that returns a ``Study``. Studies of the
papers use simulated people; those of README's figures use recordings where there are
any. ``claims.toml`` lists the figures that ``claims`` compares with the measured ones.
"""

import hashlib
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path

from kinefilter.characters.arrays import check_choice
from kinefilter.pipeline.formats import atomic_path

from . import (
    chiang,
    claims,
    detection,
    liu,
    method_comparison,
    shum,
    study,
    tracker_studies,
    wang,
)
from .cleaned_takes import chairs, cleaned_takes, dribbled_ball, held_box
from .speed import million_postures, speed
from .study import Options, Study, as_table
from .study_takes import recordings_folder

__all__ = ["Options", "Study", "as_table", "claims", "recordings_folder", "study"]

_FLOORS = ("characters", "retarget", "scenes", "pipeline")
_SUFFIXES = (".py", ".toml", ".xml", ".npz", ".csv")
_EXCEPT = ("claims.toml",)  # has no effect on what is measured

_WITH_QUICK_SIZES: tuple[tuple[Callable[..., Study], dict[str, int]], ...] = (
    (cleaned_takes, {"count": 2}),
    (method_comparison.methods_new_people, {"count": 2, "movements": 1}),
    (method_comparison.methods_known_people, {"count": 1, "movements": 1}),
    (detection.failures, {"count": 2, "movements": 1}),
    (detection.reliability, {"takes": 1, "movements": 1}),
    (held_box, {"count": 1}),
    (dribbled_ball, {"count": 1}),
    (chairs, {"count": 1}),
    (speed, {"rounds": 1}),
    (million_postures, {"values": 2, "people": 1}),
    (shum.shum_tables_1_2, {"people": 1, "takes": 1}),
    (shum.shum_table_3, {"motions": 1}),
    (shum.shum_table_4, {"takes": 1}),
    (shum.shum_figure_8, {"motions": 1, "values": 2}),
    (liu.liu_figure_3, {"people": 2, "values": 2}),
    (liu.liu_figure_7, {"people": 2, "values": 1}),
    (liu.liu_figure_8, {"people": 2}),
    (liu.liu_table_2, {"people": 2, "motions": 1}),
    (liu.liu_table_3, {"people": 1, "motions": 1}),
    (liu.liu_table_4, {"people": 2, "motions": 1, "clips": 1}),
    (liu.liu_table_5, {"people": 2, "count": 2, "clips": 2}),
    (chiang.chiang_figure_5, {"people": 4, "values": 4}),
    (chiang.chiang_figure_7, {"people": 2}),
    (chiang.chiang_table_1, {"movements": 1}),
    (chiang.chiang_tables_2_3, {"people": 2, "motions": 1, "count": 1}),
    (wang.wang_figure_1, {"frames": 241}),
    (wang.wang_table_1, {"sizes": 2}),
    (method_comparison.presets, {"count": 2, "clips": 1}),
    (tracker_studies.tracker_errors, {"clips": 1}),
    (tracker_studies.tracker_lessons, {"people": 4, "clips": 1}),
)
STUDIES = {run.__name__.replace("_", "-"): (run, q) for run, q in _WITH_QUICK_SIZES}
"""Each study by its name on the command line, and sizes for a quick run."""


def check_names(names: Sequence[str]) -> None:
    """Raise an InputError if a name is not that of a study."""
    for name in names:
        check_choice(name, STUDIES, "study")


def reproduce(name: str, options: Options, *, quick: bool = False) -> Study:
    """Run a study, or a ``quick`` part of it; InputError if unknown or without data."""
    check_names([name])
    run, sizes = STUDIES[name]
    return run(options, **(sizes if quick else {}))


def fingerprint(data: Path | None, *, seed: int, quick: bool) -> str:
    """Return a hash of everything that figures depend on: source code and recordings.

    Recordings enter by name, size and time. An interrupted run resumes with the studies
    that are missing or have another fingerprint.
    """
    digest = hashlib.sha256(f"{seed} {quick}".encode())
    for floor in _FLOORS:
        folder = Path(str(resources.files(f"kinefilter.{floor}")))
        for path in sorted(folder.rglob("*")):
            if path.suffix in _SUFFIXES and path.name not in _EXCEPT:
                digest.update(str(path.relative_to(folder)).encode())
                digest.update(path.read_bytes())
    for path in sorted(data.rglob("*")) if data else ():
        status = path.stat()
        digest.update(f"{path} {status.st_size} {status.st_mtime_ns}".encode())
    return digest.hexdigest()


def is_up_to_date(name: str, folder: Path, stamp: str) -> bool:
    """Return True if a folder has a study's table with this fingerprint."""
    noted, table = folder / f"{name}.made", folder / f"{name}.csv"
    return table.is_file() and noted.is_file() and noted.read_text("utf-8") == stamp


def record_fingerprint(name: str, folder: Path, stamp: str) -> None:
    """Record the fingerprint of a study's table."""
    with atomic_path(folder / f"{name}.made") as temporary:
        temporary.write_text(stamp, encoding="utf-8", newline="\n")
