"""The character as USD: a skeleton in T-pose and the mesh that is bound to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import Body, InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import matrix_from_wxyz
from kinefilter.characters.skin import INFLUENCES, skin_of

from .export import Export
from .rig import Rig, rig_of

CHARACTER = "/Character"
SKELETON = f"{CHARACTER}/Skeleton"
SKIN = f"{CHARACTER}/Skin"
ANIMATION = f"{CHARACTER}/Animation"

_COLOR = (0.11, 0.24, 0.32)  # linear; a quiet color that no prop has


def set_axes(stage: Any, export: Export) -> None:
    """Say which axis points up and what the unit of length is."""
    from pxr import UsdGeom

    up = UsdGeom.Tokens.z if export.up == "z" else UsdGeom.Tokens.y
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, export.meters_per_unit)


def joint_paths(rig: Rig) -> list[str]:
    """Return the path of each node from the root on, as UsdSkel names joints.

    What USD does not allow in names, such as the colon of ``mixamorig:Hips``, becomes
    an underscore.
    """
    from pxr import Tf

    paths: list[str] = []
    names = [Tf.MakeValidIdentifier(name) for name in rig.names]
    for name, parent in zip(names, rig.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def write_character(body: Body, path: Path, export: Export) -> None:
    """Write a layer with nothing but the character, for clips to refer to.

    Raises:
        pxr.Tf.ErrorException: The file cannot be written.
    """
    from pxr import Kind, Sdf, Usd

    stage = Usd.Stage.Open(Sdf.Layer.CreateNew(str(path)))
    set_axes(stage, export)
    define_character(stage, body, export)
    root = stage.GetPrimAtPath(CHARACTER)
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    stage.GetRootLayer().Save()


def check_character(path: Path, rig: Rig, export: Export) -> None:
    """Raise an InputError if clips of a rig cannot go over a character's layer."""
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException:
        raise InputError(
            f"{path}: cannot be read as USD; give --character a layer of "
            "'kinefilter clean --character', or a name that is free"
        ) from None
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath(SKELETON))
    joints = skeleton.GetJointsAttr().Get() if skeleton else None
    if joints is None or list(joints) != joint_paths(rig):
        raise InputError(
            f"{path}: {SKELETON} does not have this take's joints; give --character "
            "another name for this kind of sensor"
        )
    up = UsdGeom.GetStageUpAxis(stage).lower()
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if up != export.up or not np.isclose(unit, export.meters_per_unit):
        raise InputError(
            f"{path}: the character has {up} up and units of {unit:g} m, the clip "
            f"{export.up} up and {export.meters_per_unit:g} m; give --up and --units "
            "of the character"
        )


def define_skeleton(stage: Any, rig: Rig, export: Export) -> None:
    """Define a skeleton at rest, and nothing else, under ``/Character``."""
    from pxr import UsdGeom, UsdSkel

    UsdSkel.Root.Define(stage, CHARACTER)
    skeleton = UsdSkel.Skeleton.Define(stage, SKELETON)
    skeleton.CreateJointsAttr(joint_paths(rig))
    places, turns = rig.at_rest
    skeleton.CreateRestTransformsAttr(_transforms(places, turns, export))
    bind = _transforms(rig.rest_positions, rig.axes, export)
    skeleton.CreateBindTransformsAttr(bind)
    points = export.points(rig.rest_positions)
    extent = _vectors(np.array([points.min(axis=0), points.max(axis=0)]))
    for path in (CHARACTER, SKELETON):
        UsdGeom.Boundable(stage.GetPrimAtPath(path)).CreateExtentAttr(extent)


def define_character(stage: Any, body: Body, export: Export) -> None:
    """Define the skeleton and the skin of a body under ``/Character``."""
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    rig = rig_of(body)
    define_skeleton(stage, rig, export)
    skin = skin_of(body)
    mesh = UsdGeom.Mesh.Define(stage, SKIN)
    points = export.points(skin.points)
    mesh.CreatePointsAttr(_vectors(points))
    mesh.CreateNormalsAttr(_vectors(export.axes(skin.normals)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    corners = skin.quads.astype(np.int32)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(corners), 4))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*_COLOR)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([SKELETON])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    nodes = rig.starts[skin.segments].astype(np.int32)
    binding.CreateJointIndicesPrimvar(False, INFLUENCES).Set(
        Vt.IntArray.FromNumpy(nodes.ravel())
    )
    binding.CreateJointWeightsPrimvar(False, INFLUENCES).Set(
        Vt.FloatArray.FromNumpy(skin.weights.astype(np.float32).ravel())
    )
    extent = _vectors(np.array([points.min(axis=0), points.max(axis=0)]))
    for path in (CHARACTER, SKIN):
        UsdGeom.Boundable(stage.GetPrimAtPath(path)).CreateExtentAttr(extent)


def _vectors(values: Array) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(values.astype(np.float32))


def _transforms(places: Array, turns: Array | None, export: Export) -> Any:
    """Return the matrices of places [m] (N, 3) and rotations (N, 4), None: identity.

    USD's vectors are rows, so a matrix is the transpose of the usual one.
    """
    from pxr import Vt

    matrices = np.tile(np.eye(4), (len(places), 1, 1))
    if turns is not None:
        turned = matrix_from_wxyz(export.axes(turns))
        matrices[:, :3, :3] = np.swapaxes(turned, 1, 2)
    matrices[:, 3, :3] = export.points(places)
    return Vt.Matrix4dArray.FromNumpy(matrices)
