"""Clips into files: the name's extension says which kind."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from kinefilter.characters import Clip, InputError

from .archive import write_npz
from .bvh_writer import write_bvh
from .files import check_folder
from .tables import write_take_csv
from .usd import write_usd

__all__ = ["check_writable", "write_clip"]

_WRITERS: dict[str, Callable[[Clip, Path], None]] = {
    ".usda": write_usd,
    ".usdc": write_usd,
    ".usd": write_usd,
    ".bvh": write_bvh,
    ".csv": write_take_csv,
    ".npz": write_npz,
}


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise, before any work is done, what write_clip would raise after it.

    Raises:
        InputError: The extension is unknown, or nothing can be written there.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in _WRITERS:
        raise InputError(
            f"{os.fspath(path)}: unknown extension {suffix!r}; "
            f"known: {', '.join(_WRITERS)}"
        )
    check_folder(path)


def write_clip(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip as USD, BVH, CSV or npz.

    All are in meters with y up. USD and BVH hold a skeleton in T-pose and rotations;
    CSV joint positions and the sensor's states; npz the whole clip.

    Args:
        clip: The motion.
        path: The file; its extension is one of ``.usda``, ``.usdc``, ``.usd``,
            ``.bvh``, ``.csv`` and ``.npz``. It appears whole or not at all.

    Raises:
        InputError: The extension is unknown, or nothing can be written there.
    """
    check_writable(path)
    _WRITERS[Path(path).suffix.lower()](clip, Path(path))
