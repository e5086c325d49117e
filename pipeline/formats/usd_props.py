"""The props of a scene as USD geometry, with their motion."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from kinefilter.characters import Clip, Prop, Shape
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import rotate

from .export import Export
from .usd_character import CHARACTER

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
LINEAR = 2.2
"""Exponent from a screen's colors to light, about that of sRGB."""


def define_props(stage: Any, clip: Clip, export: Export, codes: Array) -> None:
    """Define every prop of a clip under ``/Character/Props``.

    Args:
        stage: Where.
        clip: The motion.
        export: Axes and unit.
        codes: Time code of each frame, shape (T,).
    """
    from pxr import Tf, UsdGeom

    if not clip.props:
        return
    folder = UsdGeom.Xform.Define(stage, f"{CHARACTER}/Props").GetPath()
    for prop in clip.props:
        name = Tf.MakeValidIdentifier(prop.name)
        while stage.GetPrimAtPath(folder.AppendChild(name)):
            name += "_"
        path = folder.AppendChild(name)
        prim = UsdGeom.Xform.Define(stage, path)
        places = export.points(prop.positions)
        turns = export.axes(prop.rotations)
        _move(prim, places, turns, codes if prop.moves else None)
        for n, shape in enumerate(prop.shapes):
            _define_shape(stage, path.AppendChild(f"Shape{n}"), shape, export)


def _move(prim: Any, places: Array, turns: Array, codes: Array | None) -> None:
    """Place a prim: for good, or with one sample per time code."""
    from pxr import Gf, Sdf

    translate = prim.AddTranslateOp().GetAttr()
    orient = prim.AddOrientOp().GetAttr()
    if codes is None:
        translate.Set(Gf.Vec3d(*places[0].tolist()))
        orient.Set(Gf.Quatf(*turns[0].tolist()))
        return
    layer = prim.GetPrim().GetStage().GetRootLayer()
    with Sdf.ChangeBlock():
        for code, place, turn in zip(
            codes.tolist(), places.tolist(), turns.tolist(), strict=True
        ):
            layer.SetTimeSample(translate.GetPath(), code, Gf.Vec3d(*place))
            layer.SetTimeSample(orient.GetPath(), code, Gf.Quatf(*turn))


def _define_shape(stage: Any, path: Any, shape: Shape, export: Export) -> None:
    from pxr import Gf, Usd, UsdGeom

    half = np.abs(export.points(shape.size))
    geometry, scale = _geometry(stage, path, shape, export)
    _move(
        geometry,
        export.points(shape.position)[None],
        export.axes(shape.rotation)[None],
        None,
    )
    if scale:
        geometry.AddScaleOp().Set(Gf.Vec3f(*half.tolist()))
    geometry.CreateDisplayColorAttr([Gf.Vec3f(*(shape.color**LINEAR).tolist())])
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(
        geometry, Usd.TimeCode.Default()
    )
    geometry.CreateExtentAttr(extent)


def _geometry(stage: Any, path: Any, shape: Shape, export: Export) -> tuple[Any, bool]:
    """Return a shape's geometry, and whether it is yet to be scaled to its size."""
    from pxr import UsdGeom, Vt

    if shape.kind == "box":
        geometry = UsdGeom.Cube.Define(stage, path)
        geometry.CreateSizeAttr(2.0)
        return geometry, True
    if shape.kind == "ellipsoid":
        geometry = UsdGeom.Sphere.Define(stage, path)
        geometry.CreateRadiusAttr(1.0)
        return geometry, True
    if shape.kind == "mesh":
        geometry = UsdGeom.Mesh.Define(stage, path)
        points = export.points(shape.points).astype(np.float32)
        geometry.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        corners = shape.triangles.astype(np.int32)
        geometry.CreateFaceVertexCountsAttr(Vt.IntArray(len(corners), 3))
        geometry.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(corners.ravel()))
        geometry.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        return geometry, False
    kind = UsdGeom.Capsule if shape.kind == "capsule" else UsdGeom.Cylinder
    geometry = kind.Define(stage, path)
    radius, half, _ = (shape.size / export.meters_per_unit).tolist()
    geometry.CreateRadiusAttr(radius)
    geometry.CreateHeightAttr(2.0 * half)
    geometry.CreateAxisAttr(UsdGeom.Tokens.z if export.up == "z" else UsdGeom.Tokens.y)
    return geometry, False


def props_extent(clip: Clip, export: Export, boxes: Array) -> Array:
    """Return boxes grown to hold the props too.

    Args:
        clip: The motion.
        export: Axes and unit.
        boxes: Lowest and highest corner in each frame, shape (T, 2, 3).
    """
    grown = boxes.copy()
    for prop in clip.props:
        corners = export.points(_corners(prop))
        np.minimum(grown[:, 0], corners.min(axis=1), out=grown[:, 0])
        np.maximum(grown[:, 1], corners.max(axis=1), out=grown[:, 1])
    return grown


def _corners(prop: Prop) -> Array:
    """Return the corners of the box around a prop's shapes [m], shape (T, 8, 3)."""
    own = np.concatenate(
        [
            shape.position + rotate(shape.rotation, _CORNERS * shape.half_extents)
            for shape in prop.shapes
        ]
    )
    low, high = own.min(axis=0), own.max(axis=0)
    corners = 0.5 * (low + high) + 0.5 * (high - low) * _CORNERS
    return np.asarray(
        prop.positions[:, None] + rotate(prop.rotations[:, None], corners)
    )
