"""Static parts of a USD clip: the skeleton in T-pose, its mesh, and the props."""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdSkel, Vt

from kinefilter.characters import Body, Clip, InputError, Shape
from kinefilter.characters.arrays import Array
from kinefilter.characters.props import CORNERS
from kinefilter.characters.rotations import matrix_from_wxyz, rotate
from kinefilter.characters.skin import INFLUENCES, skin_of

from .export import GAMMA, SKIN_COLOR, Export
from .guarded import read_usd
from .rig import Rig, rig_of

# m between joints at rest of two people. Those of takes of one person (p00, p04, p08,
# p10, p14, sensors at 0 to 90 degrees) differ by up to 0.176; of p02, p06, p12, p16 and
# p18, who had no say, by 0.145.
_ANOTHER = 0.2

CHARACTER = "/Character"
SKELETON = f"{CHARACTER}/Skeleton"
SKIN = f"{CHARACTER}/Skin"
ANIMATION = f"{CHARACTER}/Animation"


def new_stage(path: Path, export: Export) -> Any:
    """Return a stage on a new layer, with axes, unit and an empty ``/Character``."""
    stage = Usd.Stage.Open(Sdf.Layer.CreateNew(str(path)))
    UsdGeom.SetStageUpAxis(stage, export.up.upper())
    UsdGeom.SetStageMetersPerUnit(stage, export.meters_per_unit)
    root = UsdSkel.Root.Define(stage, CHARACTER).GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    return stage


def set_samples(layer: Any, path: Any, codes: Array, values: Iterable[Any]) -> None:
    """Set time samples in a layer; going through a stage would look up each one."""
    with Sdf.ChangeBlock():
        for code, value in zip(codes.tolist(), values, strict=True):
            layer.SetTimeSample(path, code, value)


def joint_paths(rig: Rig) -> list[str]:
    """Return the path of each node from the root, as UsdSkel names joints."""
    paths: list[str] = []
    for name, parent in zip(rig.names, rig.parents, strict=True):
        path = Tf.MakeValidIdentifier(name)
        paths.append(path if parent < 0 else f"{paths[parent]}/{path}")
    return paths


def check_character(path: Path, rig: Rig, export: Export) -> None:
    """Raise an InputError if clips of a rig cannot reference a character layer."""
    layer = _character(str(path), path.stat().st_mtime_ns)
    places, wanted = layer["places"], export.points(rig.positions)
    if layer["joints"].tolist() != joint_paths(rig) or len(places) != len(wanted):
        wrong = "does not have this take's joints; give --character another name"
        raise InputError(f"{path}: {SKELETON} {wrong}")
    up, unit = str(layer["up"]), layer["unit"].item()
    if up != export.up or not np.isclose(unit, export.meters_per_unit):
        raise InputError(
            f"{path}: the character has {up} up and units of {unit:g} m, the clip "
            f"{export.up} up and {export.meters_per_unit:g} m; set --up and --units"
        )
    away = np.linalg.norm(places - wanted, axis=1).max() * unit
    if not away <= _ANOTHER:
        raise InputError(
            f"{path}: the character is of somebody of another size: its joints are up "
            f"to {100.0 * away:.0f} cm from where this person's are at rest; give each "
            "person a --character of their own"
        )


@lru_cache(maxsize=4)
def _character(path: str, _changed: int) -> dict[str, NDArray[Any]]:
    """Return ``character_arrays``, read once for all clips of a batch."""
    return read_usd("character_arrays", path)


def define_skeleton(stage: Any, rig: Rig, export: Export) -> None:
    """Define a skeleton at rest under ``/Character``."""
    skeleton = UsdSkel.Skeleton.Define(stage, SKELETON)
    skeleton.CreateJointsAttr(joint_paths(rig))
    skeleton.CreateRestTransformsAttr(_transforms(*rig.at_rest, export))
    skeleton.CreateBindTransformsAttr(_transforms(rig.positions, rig.axes, export))
    _set_extent(stage, export.points(rig.positions), SKELETON)


def define_character(stage: Any, body: Body, export: Export) -> None:
    """Define the skeleton and the skin of a body under ``/Character``."""
    rig, skin = rig_of(body), skin_of(body)
    define_skeleton(stage, rig, export)
    points = export.points(skin.points)
    mesh = _mesh(stage, SKIN, points, skin.quads)
    mesh.CreateNormalsAttr(vectors(export.axes(skin.normals)))
    mesh.SetNormalsInterpolation("vertex")
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*SKIN_COLOR)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([SKELETON])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    nodes = rig.segment_nodes[skin.segments].astype(np.int32)
    indices = binding.CreateJointIndicesPrimvar(False, INFLUENCES)
    indices.Set(Vt.IntArray.FromNumpy(nodes.ravel()))
    weights = binding.CreateJointWeightsPrimvar(False, INFLUENCES)
    weights.Set(Vt.FloatArray.FromNumpy(skin.weights.astype(np.float32).ravel()))
    _set_extent(stage, points, SKIN)


def _set_extent(stage: Any, points: Array, path: str) -> None:
    extent = vectors(np.array([points.min(axis=0), points.max(axis=0)]))
    for name in (CHARACTER, path):
        UsdGeom.Boundable(stage.GetPrimAtPath(name)).CreateExtentAttr(extent)


def vectors(values: NDArray[Any]) -> Any:
    """Return rows of three numbers as a USD array in single precision."""
    return Vt.Vec3fArray.FromNumpy(values.astype(np.float32))


def _transforms(places: Array, turns: Array | None, export: Export) -> Any:
    """Return matrices from positions [m] (N, 3) and rotations (N, 4), if any."""
    matrices = np.tile(np.eye(4), (len(places), 1, 1))
    if turns is not None:
        matrices[:, :3, :3] = np.swapaxes(matrix_from_wxyz(export.axes(turns)), 1, 2)
    matrices[:, 3, :3] = export.points(places)
    return Vt.Matrix4dArray.FromNumpy(matrices)


def _mesh(stage: Any, path: Any, points: Array, faces: NDArray[Any]) -> Any:
    mesh = UsdGeom.Mesh.Define(stage, path)
    corners = faces.astype(np.int32).ravel()
    mesh.CreatePointsAttr(vectors(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(*faces.shape))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    return mesh


def define_props(stage: Any, clip: Clip, export: Export, codes: Array) -> None:
    """Define every prop of a clip; ``codes`` are the frames' time codes (T,)."""
    if not clip.props:
        return
    folder = UsdGeom.Xform.Define(stage, f"{CHARACTER}/Props").GetPath()
    for prop in clip.props:
        path = folder.AppendChild(Tf.MakeValidIdentifier(prop.name))
        while stage.GetPrimAtPath(path):
            path = folder.AppendChild(f"{path.name}_")
        prim = UsdGeom.Xform.Define(stage, path)
        places, turns = export.points(prop.positions), export.axes(prop.rotations)
        _move(prim, places, turns, codes if prop.moves else None)
        for n, shape in enumerate(prop.shapes):
            _define_shape(stage, path.AppendChild(f"Shape{n}"), shape, export)


def _move(prim: Any, places: Array, turns: Array, codes: Array | None) -> None:
    """Place a prim: permanently, or with a sample for each time code."""
    translate = prim.AddTranslateOp(), [Gf.Vec3d(*place) for place in places.tolist()]
    orient = prim.AddOrientOp(), [Gf.Quatf(*turn) for turn in turns.tolist()]
    layer = prim.GetPrim().GetStage().GetRootLayer()
    for operation, values in (translate, orient):
        if codes is None:
            operation.Set(values[0])
        else:
            set_samples(layer, operation.GetAttr().GetPath(), codes, values)


def _define_shape(stage: Any, path: Any, shape: Shape, export: Export) -> None:
    if shape.kind == "mesh":
        geometry = _mesh(stage, path, export.points(shape.points), shape.triangles)
    elif shape.kind == "box":
        geometry = UsdGeom.Cube.Define(stage, path)
        geometry.CreateSizeAttr(2.0)
    elif shape.kind == "ellipsoid":
        geometry = UsdGeom.Sphere.Define(stage, path)
        geometry.CreateRadiusAttr(1.0)
    else:
        kind = UsdGeom.Capsule if shape.kind == "capsule" else UsdGeom.Cylinder
        geometry = kind.Define(stage, path)
        radius, half, _ = (shape.size / export.meters_per_unit).tolist()
        geometry.CreateRadiusAttr(radius)
        geometry.CreateHeightAttr(2.0 * half)
        geometry.CreateAxisAttr(export.up.upper())
    place, turn = export.points(shape.position), export.axes(shape.rotation)
    _move(geometry, place[None], turn[None], None)
    if shape.kind in ("box", "ellipsoid"):
        geometry.AddScaleOp().Set(Gf.Vec3f(*np.abs(export.points(shape.size)).tolist()))
    geometry.CreateDisplayColorAttr([Gf.Vec3f(*(shape.color**GAMMA).tolist())])
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins
    geometry.CreateExtentAttr(extent(geometry, Usd.TimeCode.Default()))


def props_extent(clip: Clip, export: Export, boxes: Array) -> Array:
    """Return boxes (T, 2, 3), lowest and highest corner, enlarged to hold the props."""
    grown = boxes.copy()
    for prop in clip.props:
        shapes = [shape.corners for shape in prop.shapes]
        low, high = np.min(shapes, axis=(0, 1)), np.max(shapes, axis=(0, 1))
        corners = 0.5 * (low + high) + 0.5 * (high - low) * CORNERS
        turned = rotate(prop.rotations[:, None], corners)
        placed = export.points(prop.positions[:, None] + turned)
        np.minimum(grown[:, 0], placed.min(axis=1), out=grown[:, 0])
        np.maximum(grown[:, 1], placed.max(axis=1), out=grown[:, 1])
    return grown
