"""What was made already, so that an interrupted run goes on where it ended."""

from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path

from kinefilter.pipeline.formats import atomic_path

_FLOORS = ("characters", "retarget", "scenes", "pipeline")
_KINDS = (".py", ".toml", ".xml", ".npz", ".csv")
_NOT_MEASURED = "claims.toml"  # judges, and measures nothing


def fingerprint(data: Path | None, *, seed: int, quick: bool) -> str:
    """Return what stands for everything that a study's figures come from.

    The whole source of kinefilter, and names, sizes and times of the recordings.
    """
    found = hashlib.sha256(f"{seed} {quick}".encode())
    for floor in _FLOORS:
        folder = Path(str(resources.files(f"kinefilter.{floor}")))
        for path in sorted(folder.rglob("*")):
            if path.suffix in _KINDS and path.name != _NOT_MEASURED:
                found.update(str(path.relative_to(folder)).encode())
                found.update(path.read_bytes())
    for path in sorted(data.rglob("*")) if data else ():
        status = path.stat()
        found.update(f"{path} {status.st_size} {status.st_mtime_ns}".encode())
    return found.hexdigest()


def is_made(name: str, folder: Path, stamp: str) -> bool:
    """Tell whether a study's table in a folder is of this fingerprint."""
    said = folder / f"{name}.made"
    table = folder / f"{name}.csv"
    return table.is_file() and said.is_file() and said.read_text("utf-8") == stamp


def say_made(name: str, folder: Path, stamp: str) -> None:
    """Note of which fingerprint a study's table is."""
    with atomic_path(folder / f"{name}.made") as temporary:
        temporary.write_text(stamp, encoding="utf-8")
