"""Clips as USD: a skinned character (UsdSkel), its animation, and what is around it.

``/Character`` holds ``Skeleton`` with rest and bind transforms in T-pose, ``Skin``, one
mesh bound to it, ``Animation``, extents in every frame, and with a scene ``Props``;
what it says of every joint and frame is listed in ``usd_provenance``. With
``--character`` a clip refers to another layer for skeleton and skin.

pxr is imported where it is used: loading it takes longer than most commands run.
"""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError

from .export import Export
from .files import atomic_path
from .rig import RigMotion, rig_of
from .usd_animation import write_animation
from .usd_character import (
    CHARACTER,
    check_character,
    define_character,
    define_skeleton,
    set_axes,
    write_character,
)
from .usd_props import define_props

_RATE_TOLERANCE = 0.005  # stamps jitter; a rate this near to a whole number is one
_STAMP = 315619200  # s: 2 January 1980, for equal packages; zip knows no earlier year
_CODE_DECIMALS = 6  # of a frame: takes rounding errors off whole frames, nothing else


def write_usd(
    clip: Clip, moved: RigMotion, path: str | os.PathLike[str], export: Export
) -> None:
    """Write a clip as a UsdSkel character in T-pose, its animation and its props.

    A frame's time code is its time since the first frame times
    ``timeCodesPerSecond``. Frames with the same time share a sample, the last one's.

    ``/Character`` is the SkelRoot, with ``Skeleton``, ``Skin`` (the mesh),
    ``Animation`` and, in a scene, ``Props`` in it. Its attributes ``kinefilter:...``
    say where the motion came from; see ``usd_provenance``. On somebody else's rig it
    is skeleton and animation alone: whose skin it wears they have, and the props are
    where our proportions reach them.

    Args:
        clip: The motion, and what is known of it.
        moved: The rig that it is written on, and what that does.
        path: The file; ``.usda`` is text, ``.usdc`` and ``.usd`` are binary, ``.usdz``
            is a package of one binary layer.
        export: Axes, unit, frame rate and, perhaps, the character's own layer.

    Raises:
        InputError: The file cannot be written, or the character does not fit.
    """
    from pxr import Tf

    try:
        with ExitStack() as files:
            temporary = files.enter_context(atomic_path(path))
            if Path(path).suffix.lower() == ".usdz":
                _write_package(clip, moved, temporary, Path(path).stem, export)
                return
            reference = _character_reference(clip, Path(path), export, files)
            text = temporary.suffix.lower() == ".usda"
            write = _write_text if text else _write_layer
            write(clip, moved, temporary, export, reference)
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: cannot be written ({error.args[0].commentary}); write elsewhere "
            "or make room"
        ) from error


def _write_package(
    clip: Clip, moved: RigMotion, path: Path, name: str, export: Export
) -> None:
    from pxr import Sdf

    with tempfile.TemporaryDirectory() as folder:
        layer = Path(folder) / "clip.usdc"
        _write_layer(clip, moved, layer, export, None)
        os.utime(layer, (_STAMP, _STAMP))
        package = Sdf.ZipFileWriter.CreateNew(str(path))
        package.AddFile(str(layer), f"{name}.usdc")
        package.Save()


def _write_text(
    clip: Clip, moved: RigMotion, path: Path, export: Export, reference: str | None
) -> None:
    """Write a text layer by way of a binary one, which needs less memory."""
    from pxr import Sdf

    with tempfile.TemporaryDirectory() as folder:
        layer = Path(folder) / "clip.usdc"
        _write_layer(clip, moved, layer, export, reference)
        Sdf.Layer.FindOrOpen(str(layer)).Export(str(path))


def _character_reference(
    clip: Clip, path: Path, export: Export, files: ExitStack
) -> str | None:
    """Return how the clip calls its character's layer, which is there then."""
    if export.character is None:
        return None
    if export.character.exists():
        check_character(export.character, rig_of(clip.body), export)
    else:
        temporary = files.enter_context(atomic_path(export.character))
        write_character(clip.body, temporary, export)
    relative = os.path.relpath(export.character.resolve(), path.parent.resolve())
    return f"./{Path(relative).as_posix()}"


def _write_layer(
    clip: Clip, moved: RigMotion, path: Path, export: Export, reference: str | None
) -> None:
    from pxr import Sdf

    layer = Sdf.Layer.CreateNew(str(path))
    _fill(layer, clip, moved, export, alone=reference is None)
    if reference is not None:
        # Last, when no stage looks for its layer, which may not be in its place yet.
        references = layer.GetPrimAtPath(CHARACTER).referenceList
        references.Prepend(Sdf.Reference(reference))
    layer.Save()


def _fill(
    layer: Any, clip: Clip, moved: RigMotion, export: Export, *, alone: bool
) -> None:
    """Write a clip into a layer, with its character if it is to stand alone."""
    from pxr import Kind, Usd, UsdSkel

    rate = export.fps or _time_codes_per_second(clip.fps)
    codes = np.round((clip.time - clip.time[0]) * rate, _CODE_DECIMALS)
    stage = Usd.Stage.Open(layer)
    set_axes(stage, export)
    _set_times(stage, rate, codes)
    if export.rig is not None:
        define_skeleton(stage, moved.rig, export)
        clip = replace(clip, props=())
    elif alone:
        define_character(stage, clip.body, export)
    root = UsdSkel.Root.Define(stage, CHARACTER)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    define_props(stage, clip, export, codes)
    write_animation(stage, clip, moved, export, codes)


def _time_codes_per_second(fps: float) -> float:
    whole = round(fps)
    return float(whole) if abs(fps - whole) <= _RATE_TOLERANCE * fps else fps


def _set_times(stage: Any, rate: float, codes: NDArray[np.float64]) -> None:
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(float(codes[-1]))
