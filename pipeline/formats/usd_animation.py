"""The animation of a USD character and its extents."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous
from kinefilter.characters.skin import skin_of

from .export import Export
from .rig import Rig, RigMotion
from .usd_character import ANIMATION, CHARACTER, SKELETON, SKIN, joint_paths
from .usd_props import props_extent
from .usd_provenance import write_provenance

_FRAMES_AT_ONCE = 1000  # bounds the memory of the conversion


def write_animation(
    stage: Any, clip: Clip, moved: RigMotion, export: Export, codes: Array
) -> None:
    """Write the animation of ``/Character`` and everything else that changes in time.

    Args:
        stage: Where; ``/Character`` is defined.
        clip: What is known of the motion, and its props.
        moved: The motion.
        export: Axes and unit.
        codes: Time code of each frame, shape (T,).
    """
    _define(stage, moved.rig)
    layer = stage.GetRootLayer()
    _write_samples(layer, moved, export, codes)
    # A binary layer reads back from its file what has been saved: an hour's samples
    # would not fit into memory beside the clip.
    layer.Save()
    _write_extents(layer, clip, moved, export, codes)
    layer.Save()
    write_provenance(layer, clip, codes)


def _define(stage: Any, rig: Rig) -> None:
    from pxr import UsdSkel, Vt

    animation = UsdSkel.Animation.Define(stage, ANIMATION)
    animation.CreateJointsAttr(joint_paths(rig))
    animation.CreateScalesAttr(
        Vt.Vec3hArray.FromNumpy(np.ones((len(rig), 3), dtype=np.float16))
    )
    animation.CreateTranslationsAttr()
    animation.CreateRotationsAttr()
    skeleton = stage.OverridePrim(SKELETON)
    binding = UsdSkel.BindingAPI.Apply(skeleton)
    binding.CreateAnimationSourceRel().SetTargets([ANIMATION])


def _write_samples(layer: Any, moved: RigMotion, export: Export, codes: Array) -> None:
    """Set the time samples straight in the layer: a stage looks each one up again."""
    from pxr import Sdf, Vt

    translations_path = Sdf.Path(f"{ANIMATION}.translations")
    rotations_path = Sdf.Path(f"{ANIMATION}.rotations")
    with Sdf.ChangeBlock():
        for code, (translations, rotations) in zip(
            codes.tolist(), _samples(moved, export), strict=True
        ):
            layer.SetTimeSample(
                translations_path, code, Vt.Vec3fArray.FromNumpy(translations)
            )
            layer.SetTimeSample(
                rotations_path, code, Vt.QuatfArray.FromNumpy(rotations)
            )


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
    """Write the boxes around joints, skin, and skin and props, in each frame.

    What has no skin has a box around its joints.
    """
    from pxr import Sdf, Vt

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
            # Whoever asks at no time in particular gets the box around all times.
            attribute = prim.attributes.get("extent") or Sdf.AttributeSpec(
                prim, "extent", Sdf.ValueTypeNames.Float3Array
            )
            whole = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
            attribute.default = Vt.Vec3fArray.FromNumpy(whole.astype(np.float32))
            for code, box in zip(codes.tolist(), boxes.astype(np.float32), strict=True):
                layer.SetTimeSample(attribute.path, code, Vt.Vec3fArray.FromNumpy(box))


def _margins(clip: Clip) -> Array:
    """Return how far the skin reaches from each joint's bones [m], shape (J,)."""
    margins = skin_of(clip.body).margins
    own = margins.copy()
    segments, parents = clip.skeleton.segments, clip.skeleton.segment_parents
    np.maximum.at(own, parents, margins[segments])
    return own
