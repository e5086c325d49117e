"""The animation of a USD character, its extents, and how far it can be trusted.

Per frame, ``/Character`` has these attributes. Arrays are in the order of
``kinefilter:joints``, lengths in meters whatever the stage's unit:

``kinefilter:reliability``
    Rate in [0, 1] of each joint's measurement.
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
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, Origin
from kinefilter.characters.skin import skin_of
from kinefilter.pipeline.reliability import Term
from kinefilter.retarget.rotations import continuous

from .export import Export
from .rig import Rig, rig_of
from .usd_character import ANIMATION, CHARACTER, SKELETON, SKIN, joint_paths
from .usd_props import props_extent

__all__ = ["write_animation"]

Array = NDArray[np.float64]

_FRAMES_AT_ONCE = 1000  # bounds the memory of the conversion
_UNMEASURED = -1.0


def write_animation(stage: Any, clip: Clip, export: Export, codes: Array) -> None:
    """Write the animation of ``/Character`` and everything else that changes in time.

    Args:
        stage: Where; ``/Character`` is defined.
        clip: The motion.
        export: Axes and unit.
        codes: Time code of each frame, shape (T,).
    """
    _define(stage, rig_of(clip.body))
    layer = stage.GetRootLayer()
    _write_samples(layer, clip, export, codes)
    # A binary layer reads back from its file what has been saved: an hour's samples
    # would not fit into memory beside the clip.
    layer.Save()
    _write_extents(layer, clip, export, codes)
    layer.Save()
    _write_honesty(layer, clip, codes)


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


def _write_samples(layer: Any, clip: Clip, export: Export, codes: Array) -> None:
    """Set the time samples straight in the layer: a stage looks each one up again."""
    from pxr import Sdf, Vt

    translations_path = Sdf.Path(f"{ANIMATION}.translations")
    rotations_path = Sdf.Path(f"{ANIMATION}.rotations")
    with Sdf.ChangeBlock():
        for code, (translations, rotations) in zip(
            codes.tolist(), _samples(clip, export), strict=True
        ):
            layer.SetTimeSample(
                translations_path, code, Vt.Vec3fArray.FromNumpy(translations)
            )
            layer.SetTimeSample(
                rotations_path, code, Vt.QuatfArray.FromNumpy(rotations)
            )


def _samples(
    clip: Clip, export: Export
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield translations (N, 3) and rotations (N, 4) of each frame.

    The rotations are xyzw, as Gf keeps quaternions in memory, and do not change sign
    from frame to frame, for readers that interpolate them number by number.
    """
    rig = rig_of(clip.body)
    translations = export.points(rig.offsets).astype(np.float32)
    roots = export.points(clip.positions[:, clip.skeleton.root])
    last = rig.local_rotations(clip.rotations[:1])
    for start in range(0, len(clip), _FRAMES_AT_ONCE):
        frames = slice(start, start + _FRAMES_AT_ONCE)
        local = rig.local_rotations(clip.rotations[frames])
        wxyz = continuous(np.concatenate([last, local]))[1:]
        last = wxyz[-1:]
        xyzw = np.roll(export.axes(wxyz), -1, axis=-1).astype(np.float32)
        for root, rotations in zip(roots[frames], xyzw, strict=True):
            translations[0] = root
            yield translations, rotations


def _write_extents(layer: Any, clip: Clip, export: Export, codes: Array) -> None:
    """Write the boxes around joints, skin, and skin and props, in each frame."""
    from pxr import Sdf, Vt

    joints = np.empty((len(clip), 2, 3))
    skin = np.empty_like(joints)
    margins = _margins(clip)[:, None] / export.meters_per_unit
    for start in range(0, len(clip), _FRAMES_AT_ONCE):
        frames = slice(start, start + _FRAMES_AT_ONCE)
        points = export.points(clip.positions[frames])
        joints[frames] = np.stack([points.min(axis=1), points.max(axis=1)], axis=1)
        low, high = (points - margins).min(axis=1), (points + margins).max(axis=1)
        skin[frames] = np.stack([low, high], axis=1)
    everything = props_extent(clip, export, skin)
    with Sdf.ChangeBlock():
        for path, boxes in ((SKELETON, joints), (SKIN, skin), (CHARACTER, everything)):
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


def _write_honesty(layer: Any, clip: Clip, codes: Array) -> None:
    """Say in attributes of the character where its motion came from."""
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    names = {
        "joints": clip.skeleton.joints,
        "decidingTermNames": [term.name.lower() for term in Term],
        "originNames": [origin.name.lower() for origin in Origin],
        "contactNames": CONTACTS,
    }
    for name, values in names.items():
        _attribute(layer, name, types.TokenArray).default = Vt.TokenArray(values)
    for name, numbers in (
        ("reliability", clip.reliability),
        ("movedByCorrection", clip.moved_by_correction),
        ("movedByPhysics", clip.moved_by_physics),
    ):
        halves = np.where(np.isnan(numbers), _UNMEASURED, numbers).astype(np.float16)
        _sample(layer, _attribute(layer, name, types.HalfArray), codes, halves)
        layer.Save()
    for name, flags in (
        ("decidingTerm", clip.deciding_term),
        ("origin", clip.origin),
    ):
        _sample(layer, _attribute(layer, name, types.UCharArray), codes, flags)
    contacts = _attribute(layer, "contacts", types.BoolArray)
    _sample(layer, contacts, codes, clip.contacts)
    force = _attribute(layer, "externalForce", types.Float)
    simulated = np.isfinite(clip.external_force)
    with Sdf.ChangeBlock():
        for code, value in zip(
            codes[simulated].tolist(),
            clip.external_force[simulated].tolist(),
            strict=True,
        ):
            layer.SetTimeSample(force.path, code, value)


def _attribute(layer: Any, name: str, kind: Any) -> Any:
    from pxr import Sdf

    character = layer.GetPrimAtPath(CHARACTER)
    return Sdf.AttributeSpec(character, f"kinefilter:{name}", kind, declaresCustom=True)


def _sample(layer: Any, attribute: Any, codes: Array, rows: NDArray[Any]) -> None:
    """Set one sample a frame, an array of a type as wide as numpy's."""
    from pxr import Sdf, Vt

    arrays = {"half[]": Vt.HalfArray, "uchar[]": Vt.UCharArray, "bool[]": Vt.BoolArray}
    convert = arrays[str(attribute.typeName)].FromNumpy
    with Sdf.ChangeBlock():
        for code, row in zip(codes.tolist(), np.ascontiguousarray(rows), strict=True):
            layer.SetTimeSample(attribute.path, code, convert(row))
