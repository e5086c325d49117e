"""Clips into files: the name's extension says which kind."""

from __future__ import annotations

import os
from pathlib import Path

from kinefilter.characters import KINECT_V2, Clip, InputError, standard_body
from kinefilter.retarget.retargeting import retarget

from .archive import write_npz
from .bvh_writer import write_bvh
from .export import Export
from .files import check_folder
from .resample import in_strict_t, resampled
from .rig import RigMotion, motion_of, retargeted_motion
from .tables import write_take_csv
from .targets import target_rig
from .usd import write_usd

_EXTENSIONS = (".usda", ".usdc", ".usd", ".usdz", ".bvh", ".csv", ".npz")


def check_writable(path: str | os.PathLike[str], export: Export | None = None) -> None:
    """Raise, before any work is done, what write_clip would raise after it.

    Raises:
        InputError: The extension is unknown, what was chosen does not go with it, or
            nothing can be written there.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in _EXTENSIONS:
        raise InputError(
            f"{os.fspath(path)}: unknown extension {suffix!r}; "
            f"known: {', '.join(_EXTENSIONS)}"
        )
    check_folder(path)
    if export is not None:
        export.check(suffix.lower())
        if export.character is not None:
            _check_character(export.character)
        if export.rig is not None:
            target_rig(export.rig, export.target, standard_body(KINECT_V2))


def _check_character(path: Path) -> None:
    if path.suffix.lower() not in (".usda", ".usdc", ".usd"):
        raise InputError(f"--character {path}: expected .usda, .usdc or .usd")
    check_folder(path)


def write_clip(
    clip: Clip, path: str | os.PathLike[str], export: Export | None = None
) -> None:
    """Write a clip as USD, BVH, CSV or npz.

    USD holds a skinned character in T-pose, rotations and props, BVH the skeleton and
    rotations; CSV joint positions and the sensor's states; npz the whole clip. On a
    rig of somebody else's, USD and BVH hold its skeleton and rotations.

    Args:
        clip: The motion.
        path: The file; its extension is one of ``.usda``, ``.usdc``, ``.usd``,
            ``.usdz``, ``.bvh``, ``.csv`` and ``.npz``. It appears whole or not at all.
        export: Axes, unit, frame rate and so on; by default meters, y up, and the
            frames of the clip.

    Raises:
        InputError: The extension is unknown, what was chosen does not go with it, or
            nothing can be written there.
    """
    export = export or Export()
    check_writable(path, export)
    if export.fps is not None:
        clip = resampled(clip, export.fps)
    if export.rest == "t":
        clip = in_strict_t(clip)
    suffix, path = Path(path).suffix.lower(), Path(path)
    if suffix == ".bvh":
        write_bvh(clip, _moved(clip, export), path, export)
    elif suffix == ".csv":
        write_take_csv(clip, path)
    elif suffix == ".npz":
        write_npz(clip, path)
    else:
        write_usd(clip, _moved(clip, export), path, export)


def _moved(clip: Clip, export: Export) -> RigMotion:
    """Return the motion on the rig that was chosen."""
    if export.rig is None:
        return motion_of(clip)
    rig = target_rig(export.rig, export.target, clip.body)
    return retargeted_motion(rig, retarget(clip, rig))
