"""The commands of the lab; like ``pipeline.commands``, they only parse and print."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from kinefilter.characters import InputError
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import Progress, over

__all__ = ["clips_of", "in_folders"]


def clips_of(files: Sequence[Path], progress: Progress) -> Iterator[PairedTake]:
    """Yield the clips of pairs files, with one file in memory at a time."""
    for file in over(files, "read", progress):
        yield from read_pairs(file)


def in_folders(paths: Sequence[Path], suffixes: tuple[str, ...]) -> list[Path]:
    """Return the paths, with each folder replaced by all files below it with a suffix.

    Raises an InputError if a folder contains no such file.
    """
    found: list[Path] = []
    for path in paths:
        inside = [path]
        if path.is_dir():
            files = (p for p in path.rglob("*") if p.is_file())
            inside = sorted(f for f in files if f.name.lower().endswith(suffixes))
        if not inside:
            raise InputError(f"{path}: no {', '.join(suffixes)} file in this folder")
        found += inside
    return found
