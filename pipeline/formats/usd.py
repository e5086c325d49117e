"""Clips as USD skeletons (UsdSkel), and their joint positions back.

pxr is imported where it is used: loading it takes longer than most commands run.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import CONTACTS, Clip, InputError
from kinefilter.retarget.rotations import continuous

from .files import atomic_path
from .rig import Rig, rig_of

__all__ = ["read_usd_positions", "write_usd"]

_CHARACTER = "/Character"
_FRAMES_AT_ONCE = 1000  # bounds the memory of the conversion
_RATE_TOLERANCE = 0.005  # stamps jitter; a rate this near to a whole number is one
_CODE_DECIMALS = 6  # of a frame: takes rounding errors off whole frames, nothing else


def write_usd(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip as a UsdSkel character in T-pose and its animation.

    The stage is in meters, y up; a frame's time code is its time since the first frame
    times ``timeCodesPerSecond``. Frames with the same time share a sample, the last
    one's. ``/Character`` is the SkelRoot, with ``Skeleton`` and ``Animation`` in it;
    its attributes ``kinefilter:contacts`` and ``kinefilter:externalForce`` are the
    clip's.

    Args:
        clip: The motion.
        path: The file; ``.usda`` is text, ``.usdc`` and ``.usd`` are binary.

    Raises:
        InputError: The file cannot be written.
    """
    from pxr import Tf

    try:
        with atomic_path(path) as temporary:
            _write_layer(clip, temporary)
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: cannot be written ({error}); write elsewhere or make room"
        ) from error


def _write_layer(clip: Clip, path: Path) -> None:
    from pxr import Sdf, Usd

    rig = rig_of(clip.body)
    rate = _time_codes_per_second(clip.fps)
    codes = np.round((clip.time - clip.time[0]) * rate, _CODE_DECIMALS)
    layer = Sdf.Layer.CreateNew(str(path))
    stage = Usd.Stage.Open(layer)
    _set_metadata(stage, rate, float(codes[-1]))
    _define_skeleton(stage, rig, clip)
    _define_animation(stage, rig)
    _write_samples(layer, rig, clip, codes)
    _write_honesty(layer, clip, codes)
    layer.Save()


def _time_codes_per_second(fps: float) -> float:
    whole = round(fps)
    return float(whole) if abs(fps - whole) <= _RATE_TOLERANCE * fps else fps


def _set_metadata(stage: Any, rate: float, end: float) -> None:
    from pxr import UsdGeom

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(end)


def _joint_paths(rig: Rig) -> list[str]:
    paths: list[str] = []
    for name, parent in zip(rig.names, rig.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def _define_skeleton(stage: Any, rig: Rig, clip: Clip) -> None:
    from pxr import Kind, Usd, UsdSkel

    root = UsdSkel.Root.Define(stage, _CHARACTER)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{_CHARACTER}/Skeleton")
    skeleton.CreateJointsAttr(_joint_paths(rig))
    local = rig.offsets.copy()
    local[0] = rig.root
    skeleton.CreateRestTransformsAttr(_translations(local))
    skeleton.CreateBindTransformsAttr(_translations(rig.rest_positions))
    extent = _extent(clip)
    root.CreateExtentAttr(extent)
    skeleton.CreateExtentAttr(extent)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([f"{_CHARACTER}/Animation"])


def _translations(vectors: NDArray[np.float64]) -> Any:
    """Return the matrices that translate by each vector (N, 3)."""
    from pxr import Gf, Vt

    return Vt.Matrix4dArray(
        [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*vector)) for vector in vectors]
    )


def _extent(clip: Clip) -> Any:
    """Return the box around the body in all frames, capsules included."""
    from pxr import Vt

    margin = clip.body.radii.max()
    low = clip.positions.min(axis=(0, 1)) - margin
    high = clip.positions.max(axis=(0, 1)) + margin
    return Vt.Vec3fArray.FromNumpy(np.array([low, high], dtype=np.float32))


def _define_animation(stage: Any, rig: Rig) -> None:
    from pxr import UsdSkel, Vt

    animation = UsdSkel.Animation.Define(stage, f"{_CHARACTER}/Animation")
    animation.CreateJointsAttr(_joint_paths(rig))
    animation.CreateScalesAttr(
        Vt.Vec3hArray.FromNumpy(np.ones((len(rig), 3), dtype=np.float16))
    )
    animation.CreateTranslationsAttr()
    animation.CreateRotationsAttr()


def _write_samples(
    layer: Any, rig: Rig, clip: Clip, codes: NDArray[np.float64]
) -> None:
    """Set the time samples straight in the layer: a stage looks each one up again."""
    from pxr import Sdf, Vt

    translations_path = Sdf.Path(f"{_CHARACTER}/Animation.translations")
    rotations_path = Sdf.Path(f"{_CHARACTER}/Animation.rotations")
    with Sdf.ChangeBlock():
        for code, (translations, rotations) in zip(
            codes.tolist(), _samples(rig, clip), strict=True
        ):
            layer.SetTimeSample(
                translations_path, code, Vt.Vec3fArray.FromNumpy(translations)
            )
            layer.SetTimeSample(
                rotations_path, code, Vt.QuatfArray.FromNumpy(rotations)
            )


def _write_honesty(layer: Any, clip: Clip, codes: NDArray[np.float64]) -> None:
    """Say in attributes of the character what held it: its feet, or no one."""
    from pxr import Sdf, Vt

    character = layer.GetPrimAtPath(_CHARACTER)
    names = Sdf.AttributeSpec(
        character, "kinefilter:contactNames", Sdf.ValueTypeNames.TokenArray
    )
    names.default = Vt.TokenArray(CONTACTS)
    contacts = Sdf.AttributeSpec(
        character, "kinefilter:contacts", Sdf.ValueTypeNames.BoolArray
    )
    force = Sdf.AttributeSpec(
        character, "kinefilter:externalForce", Sdf.ValueTypeNames.Float
    )
    force.documentation = "Body weights that no muscle and no floor gives."
    with Sdf.ChangeBlock():
        for code, flags, value in zip(
            codes.tolist(),
            clip.contacts.tolist(),
            clip.external_force.tolist(),
            strict=True,
        ):
            layer.SetTimeSample(contacts.path, code, Vt.BoolArray(flags))
            if np.isfinite(value):
                layer.SetTimeSample(force.path, code, value)


def _samples(
    rig: Rig, clip: Clip
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield translations (N, 3) and rotations (N, 4) of each frame.

    The rotations are xyzw, as Gf keeps quaternions in memory, and do not change sign
    from frame to frame, for readers that interpolate them number by number.
    """
    translations = rig.offsets.astype(np.float32)
    roots = clip.positions[:, clip.skeleton.root]
    last = rig.local_rotations(clip.rotations[:1])
    for start in range(0, len(clip), _FRAMES_AT_ONCE):
        frames = slice(start, start + _FRAMES_AT_ONCE)
        local = rig.local_rotations(clip.rotations[frames])
        wxyz = continuous(np.concatenate([last, local]))[1:]
        last = wxyz[-1:]
        xyzw = np.roll(wxyz, -1, axis=-1).astype(np.float32)
        for root, rotations in zip(roots[frames], xyzw, strict=True):
            translations[0] = root
            yield translations, rotations


def read_usd_positions(
    path: str | os.PathLike[str],
) -> tuple[NDArray[np.float64], tuple[str, ...], NDArray[np.float64]]:
    """Return where UsdSkel puts the joints of the first animated skeleton.

    Args:
        path: A USD file.

    Returns:
        Time of each sample since time code 0 [s], shape (T,); joint names, shape (N,);
        world positions [m], stage axes, shape (T, N, 3).

    Raises:
        InputError: The file cannot be opened or has no animated skeleton.
    """
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file; check the name")
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except Tf.ErrorException:
        raise InputError(
            f"{path}: cannot be read as USD; expected .usda, .usdc or .usd"
        ) from None
    cache = UsdSkel.Cache()
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
        if prim.IsA(UsdSkel.Skeleton):
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            if query and query.GetAnimQuery():
                meters = UsdGeom.GetStageMetersPerUnit(stage)
                return _skeleton_positions(stage, prim, query, meters)
    raise InputError(f"{path}: has no animated skeleton; expected a UsdSkel animation")


def _skeleton_positions(
    stage: Any, prim: Any, query: Any, meters: float
) -> tuple[NDArray[np.float64], tuple[str, ...], NDArray[np.float64]]:
    from pxr import Gf, UsdGeom

    names = tuple(str(joint).rpartition("/")[2] for joint in query.GetJointOrder())
    codes = query.GetAnimQuery().GetJointTransformTimeSamples()
    positions = np.empty((len(codes), len(names), 3))
    for frame, code in enumerate(codes):
        world = UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(code)
        matrices = np.array(query.ComputeJointSkelTransforms(code))
        places = matrices[:, 3, :3] @ np.array(world)[:3, :3]
        positions[frame] = places + np.array(Gf.Matrix4d(world).ExtractTranslation())
    time = np.array(codes) / stage.GetTimeCodesPerSecond()
    return time, names, positions * meters
