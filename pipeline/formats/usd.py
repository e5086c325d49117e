"""Writing clips as USD: a skinned character (UsdSkel), its animation and props.

``/Character`` is the SkelRoot, with ``Skeleton`` (rest and bind transforms in T-pose),
``Skin`` (one mesh bound to it), ``Animation``, extents in every frame, and in a scene
``Props``. With ``--character`` a clip references another layer for skeleton and skin.
With a rig it has only skeleton and animation: the rig has its own skin, and the props
are within reach of our proportions, not of the rig's.

Provenance is in attributes ``kinefilter:NAME`` of ``/Character``, with the names and
meanings of GLB's ``extras`` (CONVENTIONS.md), but fractions and meters instead of
percent and millimeters, whatever the stage's unit; -1 where unknown. ``externalForce``
has no sample without physics. ``sensorTilt``, ``floorHeight`` and ``sensorRoll`` are
left out where unknown, or if there was no roll.
"""

import os
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from errno import ENOSPC
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
from pxr import Sdf, Tf, UsdSkel, Vt

from kinefilter.characters import Clip, InputError
from kinefilter.characters.arrays import Array, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous
from kinefilter.characters.skin import skin_of

from . import usd_character as parts
from .export import PER_CLIP, PER_FRAME, Export, name_tables, whole_rate
from .files import atomic_path
from .rig import RigMotion, rig_of
from .usd_character import CHARACTER, SKELETON, SKIN, joint_paths, set_samples, vectors

_STAMP = (1980, 1, 2, 0, 0, 0, 0, 0, -1)
"""Local time of the file in a package, which zip stores, so that equal clips give equal
bytes in every time zone; zip knows no earlier year."""
_CODE_DECIMALS = 6  # of a frame: removes rounding errors from whole frames
_UNKNOWN = -1.0


def write_usd(clip: Clip, motion: RigMotion, path: Path, export: Export) -> None:
    """Write a clip as a UsdSkel character in T-pose, its animation and its props.

    CONVENTIONS.md describes the time codes. ``.usda`` is text, ``.usdc`` and ``.usd``
    are binary, ``.usdz`` is a package with one binary layer. Raises InputError if the
    file cannot be written, or if the character does not match.
    """
    suffix = path.suffix.lower()
    try:
        with ExitStack() as files:
            temporary = files.enter_context(atomic_path(path))
            layer = temporary
            if suffix in (".usda", ".usdz"):
                # Writing text via a binary layer needs less memory.
                folder = files.enter_context(tempfile.TemporaryDirectory())
                layer = Path(folder) / "clip.usdc"
            reference = _reference(clip, path, export, files)
            _write_layer(clip, motion, layer, export, reference)
            if suffix == ".usda":
                Sdf.Layer.FindOrOpen(str(layer)).Export(str(temporary))
            elif suffix == ".usdz":
                os.utime(layer, (time.mktime(_STAMP),) * 2)
                # Without the with block, it would write even after an interrupt.
                with Sdf.ZipFileWriter.CreateNew(str(temporary)) as package:
                    package.AddFile(str(layer), layer.name)
                if not is_zipfile(temporary):  # it does not report a full disk
                    raise OSError(ENOSPC, os.strerror(ENOSPC))
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: cannot be written ({error.args[0].commentary}); write elsewhere"
        ) from error


def _reference(clip: Clip, path: Path, export: Export, files: ExitStack) -> str | None:
    if export.character is None:
        return None
    if export.character.exists():
        parts.check_character(export.character, rig_of(clip.body), export)
    else:
        layer = files.enter_context(atomic_path(export.character))
        stage = parts.new_stage(layer, export)
        parts.define_character(stage, clip.body, export)
        stage.GetRootLayer().Save()
    relative = os.path.relpath(export.character.resolve(), path.parent.resolve())
    return f"./{Path(relative).as_posix()}"


def _write_layer(
    clip: Clip, motion: RigMotion, path: Path, export: Export, reference: str | None
) -> None:
    """Write a clip to a layer, with its character unless it references one."""
    rate = export.fps or whole_rate(clip.fps)
    codes = np.round((clip.time - clip.time[0]) * rate, _CODE_DECIMALS)
    stage = parts.new_stage(path, export)
    layer = stage.GetRootLayer()
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(float(codes[-1]))
    if export.rig is not None:
        parts.define_skeleton(stage, motion.rig, export)
        clip = replace(clip, props=())
    elif reference is None:
        parts.define_character(stage, clip.body, export)
    parts.define_props(stage, clip, export, codes)
    _animate(stage, motion, export, codes)
    # Once saved, a binary layer reads its samples from the file: an hour of them would
    # not fit into memory beside the clip.
    layer.Save()
    _write_extents(layer, clip, motion, export, codes)
    layer.Save()
    _hold_still(layer, clip, codes)
    _write_provenance(layer, clip, codes, export.root)
    if reference is not None:
        # Last, once no stage resolves the reference: its layer may not exist yet.
        del stage
        layer.GetPrimAtPath(CHARACTER).referenceList.Prepend(Sdf.Reference(reference))
    layer.Save()


def _animate(stage: Any, motion: RigMotion, export: Export, codes: Array) -> None:
    """Write the local translations and rotations of the nodes in each frame.

    Rotations are xyzw, as Gf stores quaternions, and do not flip their sign from frame
    to frame, for readers that interpolate the components.
    """
    rig, layer = motion.rig, stage.GetRootLayer()
    animation = UsdSkel.Animation.Define(stage, parts.ANIMATION)
    animation.CreateJointsAttr(joint_paths(rig))
    ones = np.ones((len(rig), 3), dtype=np.float16)
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(ones))
    translations = animation.CreateTranslationsAttr().GetPath()
    rotations = animation.CreateRotationsAttr().GetPath()
    binding = UsdSkel.BindingAPI.Apply(stage.OverridePrim(SKELETON))
    binding.CreateAnimationSourceRel().SetTargets([parts.ANIMATION])
    rest = export.points(rig.at_rest[0])
    last = rig.local_rotations(motion.rotations[:1])
    for some in chunks(len(codes)):
        local = rig.local_rotations(motion.rotations[some])
        wxyz = continuous(np.concatenate([last, local]))[1:]
        last = wxyz[-1:]
        places = np.tile(rest, (len(wxyz), 1, 1))
        for node, path in motion.places.items():
            places[:, node] = export.points(path[some])
        set_samples(layer, translations, codes[some], map(vectors, places))
        xyzw = np.roll(export.axes(wxyz), -1, axis=-1).astype(np.float32)
        set_samples(layer, rotations, codes[some], map(Vt.QuatfArray.FromNumpy, xyzw))


def _write_extents(
    layer: Any, clip: Clip, motion: RigMotion, export: Export, codes: Array
) -> None:
    """Write the bounding boxes of joints, skin, and skin with props, in each frame."""
    joints = np.empty((len(clip), 2, 3))
    skin = np.empty_like(joints)
    margins: Any = 0.0  # from each joint to the surface of the skin, in file units
    if export.rig is None:
        reach = skin_of(clip.body).margins
        margins = reach.copy()
        segments, parents = clip.skeleton.segments, clip.skeleton.segment_parents
        np.maximum.at(margins, parents, reach[segments])
        margins = margins[:, None] / export.meters_per_unit
    for some in chunks(len(clip)):
        points = export.points(motion.positions[some])
        joints[some, 0], joints[some, 1] = points.min(axis=1), points.max(axis=1)
        skin[some, 0] = (points - margins).min(axis=1)
        skin[some, 1] = (points + margins).max(axis=1)
    extents = {SKELETON: joints, CHARACTER: parts.props_extent(clip, export, skin)}
    if export.rig is None:
        extents[SKIN] = skin
    for path, boxes in extents.items():
        prim = Sdf.CreatePrimInLayer(layer, path)
        known, kind = prim.attributes.get("extent"), Sdf.ValueTypeNames.Float3Array
        attribute = known or Sdf.AttributeSpec(prim, "extent", kind)
        # Readers that ask without a time get the box around all frames.
        around = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        attribute.default = vectors(around)
        set_samples(layer, attribute.path, codes, map(vectors, boxes))


def _hold_still(layer: Any, clip: Clip, codes: Array) -> None:
    """Repeat all samples so far at the end of long gaps, since readers interpolate."""
    ends = [part.start for part in parts_of(clip.time)[1:]]

    def hold(path: Any) -> None:
        if path.IsPropertyPath() and layer.GetNumTimeSamplesForPath(path):
            for k in ends:
                last = layer.QueryTimeSample(path, codes[k - 1])
                layer.SetTimeSample(path, codes[k] - 1.0, last)

    if ends:
        layer.Traverse("/", hold)
        layer.Save()


def _write_provenance(layer: Any, clip: Clip, codes: Array, root: str) -> None:
    types, character = Sdf.ValueTypeNames, layer.GetPrimAtPath(CHARACTER)

    def attribute(name: str, kind: Any) -> Any:
        name = f"kinefilter:{name}"
        return Sdf.AttributeSpec(character, name, kind, declaresCustom=True)

    attribute("root", types.Token).default = root
    for name, values in name_tables(clip.skeleton).items():
        attribute(name, types.TokenArray).default = Vt.TokenArray(values)
    for name, field in PER_CLIP.items():
        number = getattr(clip, field)
        if np.isfinite(number) and (number or field != "roll"):
            attribute(name, types.Double).default = number
    for name, field in PER_FRAME.items():
        rows = getattr(clip, field)
        kind = {"f": "HalfArray", "u": "UCharArray", "b": "BoolArray"}[rows.dtype.kind]
        if kind == "HalfArray":
            rows = np.where(np.isnan(rows), _UNKNOWN, rows).astype(np.float16)
        arrays = map(getattr(Vt, kind).FromNumpy, np.ascontiguousarray(rows))
        set_samples(layer, attribute(name, getattr(types, kind)).path, codes, arrays)
        if kind == "HalfArray":
            layer.Save()
    known = np.isfinite(clip.external_force)
    path, force = attribute("externalForce", types.Float).path, clip.external_force
    set_samples(layer, path, codes[known], force[known].tolist())
