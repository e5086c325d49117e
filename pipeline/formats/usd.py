"""Clips as USD: a skinned character (UsdSkel), its animation, and what is around it.

``/Character`` is the SkelRoot, with ``Skeleton`` (rest and bind transforms in T-pose),
``Skin`` (one mesh bound to it), ``Animation``, extents in every frame, and in a scene
``Props``. With ``--character`` a clip refers to another layer for skeleton and skin. On
somebody else's rig it is skeleton and animation alone: they have its skin, and props
are where our proportions reach them.

Per frame, ``/Character`` has these attributes. Arrays are in the order of
``kinefilter:joints``, lengths in meters whatever the stage's unit:

``kinefilter:reliability``
    Reliability in [0, 1] of each joint's measurement.
``kinefilter:decidingTerm``
    Which term decided it, an index of ``kinefilter:decidingTermNames``.
``kinefilter:origin``
    Where each joint came from, an index of ``kinefilter:originNames``.
``kinefilter:movedByCorrection``, ``kinefilter:movedByPhysics``
    How far each joint was moved, -1 where nothing was measured.
``kinefilter:contacts``
    Which of ``kinefilter:contactNames`` stand on the floor.
``kinefilter:externalForce``
    Body weights that no muscle and no floor gives; no sample without physics.

What cleaning did to the whole take is written once, unless it is unknown:

``kinefilter:sensorTilt``
    Angle in radians by which the take was turned about the sensor's x axis, positive
    where the floor rose away from the sensor: ``y cos - z sin`` is up.
``kinefilter:floorHeight``
    Height of the floor in the take so leveled, which was then taken off.

pxr is imported where it is used: loading it takes longer than most commands run.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous
from kinefilter.characters.skin import skin_of

from .export import Export
from .files import atomic_path
from .rig import RigMotion, rig_of
from .usd_character import (
    ANIMATION,
    CHARACTER,
    PER_FRAME,
    SKELETON,
    SKIN,
    check_character,
    define_character,
    define_props,
    define_skeleton,
    joint_paths,
    name_tables,
    props_extent,
    set_axes,
    vectors,
    write_character,
)

_RATE_TOLERANCE = 0.005  # stamps jitter; a rate this near to a whole number is one
_STAMP = 315619200  # s: 2 January 1980, for equal packages; zip knows no earlier year
_CODE_DECIMALS = 6  # of a frame: takes rounding errors off whole frames, nothing else
_FRAMES_AT_ONCE = 1000  # bounds the memory of the conversion
_UNMEASURED = -1.0


def write_usd(
    clip: Clip, moved: RigMotion, path: str | os.PathLike[str], export: Export
) -> None:
    """Write a clip as a UsdSkel character in T-pose, its animation and its props.

    A frame's time code is its time since the first frame times ``timeCodesPerSecond``.
    Frames with the same time share a sample, the last one's. ``.usda`` is text,
    ``.usdc`` and ``.usd`` are binary, ``.usdz`` is a package of one binary layer.
    Raises InputError if the file cannot be written, or the character does not fit.
    """
    from pxr import Sdf, Tf

    suffix = Path(path).suffix.lower()
    try:
        with ExitStack() as files:
            temporary = files.enter_context(atomic_path(path))
            reference = _character_reference(clip, Path(path), export, files)
            if suffix not in (".usda", ".usdz"):
                _write_layer(clip, moved, temporary, export, reference)
                return
            # Text by way of a binary layer needs less memory.
            folder = files.enter_context(tempfile.TemporaryDirectory())
            layer = Path(folder) / "clip.usdc"
            _write_layer(clip, moved, layer, export, reference)
            if suffix == ".usda":
                Sdf.Layer.FindOrOpen(str(layer)).Export(str(temporary))
                return
            os.utime(layer, (_STAMP, _STAMP))
            package = Sdf.ZipFileWriter.CreateNew(str(temporary))
            package.AddFile(str(layer), f"{Path(path).stem}.usdc")
            package.Save()
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: cannot be written ({error.args[0].commentary}); write elsewhere"
        ) from error


def _character_reference(
    clip: Clip, path: Path, export: Export, files: ExitStack
) -> str | None:
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
    """Write a clip into a layer, with its character unless that is a reference."""
    from pxr import Kind, Sdf, Usd, UsdSkel

    layer = Sdf.Layer.CreateNew(str(path))
    whole = round(clip.fps)
    near = abs(clip.fps - whole) <= _RATE_TOLERANCE * clip.fps
    rate = export.fps or (float(whole) if near else clip.fps)
    codes = np.round((clip.time - clip.time[0]) * rate, _CODE_DECIMALS)
    stage = Usd.Stage.Open(layer)
    set_axes(stage, export)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(float(codes[-1]))
    if export.rig is not None:
        define_skeleton(stage, moved.rig, export)
        clip = replace(clip, props=())
    elif reference is None:
        define_character(stage, clip.body, export)
    root = UsdSkel.Root.Define(stage, CHARACTER)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    define_props(stage, clip, export, codes)
    _define_animation(stage, moved)
    # A binary layer reads back from its file what has been saved: an hour's samples
    # would not fit into memory beside the clip.
    _write_motion(layer, moved, export, codes)
    layer.Save()
    _write_extents(layer, clip, moved, export, codes)
    layer.Save()
    _write_provenance(layer, clip, codes)
    if reference is not None:
        # Last, when no stage looks for its layer, which may not be in its place yet.
        del root, stage
        references = layer.GetPrimAtPath(CHARACTER).referenceList
        references.Prepend(Sdf.Reference(reference))
    layer.Save()


def _define_animation(stage: Any, moved: RigMotion) -> None:
    from pxr import UsdSkel, Vt

    rig = moved.rig
    animation = UsdSkel.Animation.Define(stage, ANIMATION)
    animation.CreateJointsAttr(joint_paths(rig))
    ones = np.ones((len(rig), 3), dtype=np.float16)
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(ones))
    animation.CreateTranslationsAttr()
    animation.CreateRotationsAttr()
    binding = UsdSkel.BindingAPI.Apply(stage.OverridePrim(SKELETON))
    binding.CreateAnimationSourceRel().SetTargets([ANIMATION])


def _write_motion(layer: Any, moved: RigMotion, export: Export, codes: Array) -> None:
    """Set the time samples straight in the layer: a stage looks each one up again."""
    from pxr import Sdf, Vt

    translations_path = Sdf.Path(f"{ANIMATION}.translations")
    rotations_path = Sdf.Path(f"{ANIMATION}.rotations")
    with Sdf.ChangeBlock():
        for code, (translations, rotations) in zip(
            codes.tolist(), _samples(moved, export), strict=True
        ):
            layer.SetTimeSample(translations_path, code, vectors(translations))
            quaternions = Vt.QuatfArray.FromNumpy(rotations)
            layer.SetTimeSample(rotations_path, code, quaternions)


def _samples(
    moved: RigMotion, export: Export
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield translations (N, 3) and rotations (N, 4) of each frame.

    The rotations are xyzw, as Gf keeps quaternions in memory, and do not change sign
    from frame to frame, for readers that interpolate them number by number.
    """
    rig = moved.rig
    translations = export.points(rig.at_rest[0]).astype(np.float32)
    path = export.points(moved.path)
    last = rig.local_rotations(moved.rotations[:1])
    for start in range(0, len(path), _FRAMES_AT_ONCE):
        frames = slice(start, start + _FRAMES_AT_ONCE)
        local = rig.local_rotations(moved.rotations[frames])
        wxyz = continuous(np.concatenate([last, local]))[1:]
        last = wxyz[-1:]
        xyzw = np.roll(export.axes(wxyz), -1, axis=-1).astype(np.float32)
        for place, rotations in zip(path[frames], xyzw, strict=True):
            translations[rig.mover] = place
            yield translations, rotations


def _write_extents(
    layer: Any, clip: Clip, moved: RigMotion, export: Export, codes: Array
) -> None:
    """Write the boxes around joints, skin, and skin and props, in each frame."""
    from pxr import Sdf

    joints = np.empty((len(clip), 2, 3))
    skin = np.empty_like(joints)
    bare = export.rig is not None
    margins = 0.0 if bare else _margins(clip)[:, None] / export.meters_per_unit
    for start in range(0, len(clip), _FRAMES_AT_ONCE):
        frames = slice(start, start + _FRAMES_AT_ONCE)
        points = export.points(moved.positions[frames])
        joints[frames] = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        low, high = (points - margins).min(axis=1), (points + margins).max(axis=1)
        skin[frames] = np.stack([low, high], axis=1)
    everything = props_extent(clip, export, skin)
    extents = {SKELETON: joints, SKIN: skin, CHARACTER: everything}
    if bare:
        del extents[SKIN]
    with Sdf.ChangeBlock():
        for path, boxes in extents.items():
            prim = Sdf.CreatePrimInLayer(layer, path)
            # Readers that ask without a time get the box around all frames.
            attribute = prim.attributes.get("extent") or Sdf.AttributeSpec(
                prim, "extent", Sdf.ValueTypeNames.Float3Array
            )
            attribute.default = vectors(
                np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
            )
            for code, box in zip(codes.tolist(), boxes, strict=True):
                layer.SetTimeSample(attribute.path, code, vectors(box))


def _margins(clip: Clip) -> Array:
    """Return how far the skin reaches from each joint's bones [m], shape (J,)."""
    margins = skin_of(clip.body).margins
    own = margins.copy()
    segments, parents = clip.skeleton.segments, clip.skeleton.segment_parents
    np.maximum.at(own, parents, margins[segments])
    return own


def _write_provenance(layer: Any, clip: Clip, codes: Array) -> None:
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    character = layer.GetPrimAtPath(CHARACTER)

    def attribute(name: str, kind: Any) -> Any:
        name = f"kinefilter:{name}"
        return Sdf.AttributeSpec(character, name, kind, declaresCustom=True)

    for name, values in name_tables(clip.skeleton).items():
        attribute(name, types.TokenArray).default = Vt.TokenArray(values)
    for name, number in (("sensorTilt", clip.tilt), ("floorHeight", clip.floor)):
        if np.isfinite(number):
            attribute(name, types.Double).default = number
    for name, field in PER_FRAME.items():
        rows = getattr(clip, field)
        kind = {"f": "HalfArray", "u": "UCharArray", "b": "BoolArray"}[rows.dtype.kind]
        if kind == "HalfArray":
            rows = np.where(np.isnan(rows), _UNMEASURED, rows).astype(np.float16)
        rows = np.ascontiguousarray(rows)
        path = attribute(name, getattr(types, kind)).path
        with Sdf.ChangeBlock():
            for code, row in zip(codes.tolist(), rows, strict=True):
                layer.SetTimeSample(path, code, getattr(Vt, kind).FromNumpy(row))
        if kind == "HalfArray":
            layer.Save()
    force = attribute("externalForce", types.Float).path
    known = np.isfinite(clip.external_force)
    with Sdf.ChangeBlock():
        for code, value in zip(
            codes[known].tolist(), clip.external_force[known].tolist(), strict=True
        ):
            layer.SetTimeSample(force, code, value)
